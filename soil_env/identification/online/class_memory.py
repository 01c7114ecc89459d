"""Memory of terrain classes on a course: estimates and best drawbar pull of each, with their
standard deviations.

A patch of a class counts with the last estimate made on it, away from its borders as the camera
sees them. Each of these estimates holds the prior, which counts once. From posteriors (m_i, s_i)
and the prior (m_0, s_0) the class gets

    s^-2 = s_0^-2 + sum (s_i^-2 - s_0^-2),    s^-2 m = s_0^-2 m_0 + sum (s_i^-2 m_i - s_0^-2 m_0),

each quantity by itself. Where two differ by more than they allow, chi-squared widens what they have
together (Birge 1932, Physical Review 40:207-227).
"""

from soil_env._compiled.flags import compiled, record
from soil_env.parameters.course import MOST_CLASSES

from .memory import BEST_PULL, LEAST_SD, QUANTITIES

# [of the sd] of the best pull of a patch, own choice: labels may be wrong, borders are near
WIDER = 1.4
# [border lengths] past the end of a border before an estimate counts, own choice: until then the
# identifier may not have found the border
FOUND = 1.0 / 3.0

_EACH = ("f8", QUANTITIES)
#: What is known of a class of terrain.
CLASS = record(patches=("i8",), estimate=_EACH, sd=_EACH)
#: Memory of a wheel: the patch that the last estimate was made on, or -1; estimate of its class and
#: its precisions from the patches before (`before`, `precision`); the classes.
CLASSES = record(patch=("i8",), before=_EACH, precision=_EACH, of=(CLASS, MOST_CLASSES))


@compiled
def forget_classes(classes, setting):
    """Set the `CLASSES` of a wheel to the prior of the identifier's `SETTING`, all without a patch;
    each sd is at least `LEAST_SD`.
    """
    classes.patch = -1
    for c in range(MOST_CLASSES):
        known = classes.of[c]
        known.patches = 0
        known.estimate = setting.prior
        for i in range(QUANTITIES):
            known.sd[i] = max(setting.prior_sd[i], LEAST_SD)


@compiled
def remember_class(classes, c, patch, memory, setting):
    """Renew class number `c` of a wheel's `CLASSES` by the estimate in the identifier's `memory`,
    made on patch number `patch`.

    It replaces an earlier estimate from the same patch. The sums are those of the module's
    docstring. The sd of the best pull counts `WIDER` times as large. From the second patch on,
    chi-squared above 1 between this estimate and the patches before widens the sd by its root. A
    quantity not better known than by the prior changes nothing.
    """
    known = classes.of[c]
    mean = classes.before
    precision = classes.precision
    if classes.patch != patch:
        classes.patch = patch
        known.patches += 1
        for i in range(QUANTITIES):
            mean[i] = known.estimate[i]
            precision[i] = known.sd[i] ** -2.0
    for i in range(QUANTITIES):
        value = memory.estimate[i]
        sd = memory.sd[i] * (WIDER if i == BEST_PULL else 1.0)
        own = max(sd, LEAST_SD) ** -2.0
        prior = max(setting.prior_sd[i], LEAST_SD) ** -2.0
        more = own - prior  # precision by the readings on this patch
        if more > 0.0:
            total = precision[i] + more
            news = own * value - prior * setting.prior[i]
            known.estimate[i] = (precision[i] * mean[i] + news) / total
            apart = 0.0  # chi-squared of this estimate and those of the patches before
            if known.patches > 1:
                apart = (value - mean[i]) ** 2 / (1.0 / own + 1.0 / precision[i])
            known.sd[i] = (max(apart, 1.0) / total) ** 0.5


@compiled
def clear_of_borders(since, left, setting):
    """True if an estimate is of one soil: made `since` [m] past the middle of the last border and
    `left` [m] before that of the next one.

    Half a border length lies on each side of a middle; past the last border `FOUND` is added.
    """
    return since > (0.5 + FOUND) * setting.border and left > 0.5 * setting.border
