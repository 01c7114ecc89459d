"""The result of the workflow: what is missing, how sure that is, the corrected model, and what they
follow from.
"""

from dataclasses import dataclass

import numpy as np

from soil_env.identification.table.data import CHANNELS
from soil_env.identification.table.noise import NoiseEstimate
from soil_env.terramechanics.model import WheelSoilModel

from .calibrate import Fit, Problem
from .corrected import Guess, model_of
from .judgement import Gap, Interval
from .locate import Disagreement
from .next_for_prediction import SurerRun
from .next_tests import Check, NextTest
from .outlook import Outlook
from .search import Finding

WORSE = 0.1  # relative rise of a held-out error by effects, above which it is stated
LEFT = 1.5  # [noise] held-out error above which a model is said to miss a channel; own choice


@dataclass(frozen=True)
class EffectFound:
    """A named effect as it is fitted."""

    name: str
    form: str  # name of the form
    parameters: dict[str, Interval]  # low = high = value where the form or the table sets it
    probability: float  # that it is missing
    share: float | None  # of the gap above the noise that it closes; None where there is none
    alternatives: tuple[str, ...]  # that these data cannot separate from it


@dataclass(frozen=True)
class Settings:
    """Inputs of a run."""

    data: str  # path of the table
    setup: str  # path of the setup, "" where no file was read
    seed: int
    data_sha256: str | None  # None where no file was read
    setup_sha256: str | None


@dataclass(frozen=True, eq=False)
class Report:
    """Everything that a run found. `soil_env.discovery.report` draws it."""

    finding: Finding
    problem: Problem
    noise: NoiseEstimate
    where: tuple[Disagreement, ...]  # between the table and the base model
    effects: tuple[EffectFound, ...]  # that are named
    soil: dict[str, Interval]  # by parameter
    gap: dict[str, Gap]  # by measured channel
    #: Share of the gap that the named effects close; None where none is named or there is no gap.
    closed: float | None
    closed_interval: tuple[float, float] | None  # 95 %; see `judgement.closed_interval`
    outlook: Outlook  # what can be predicted, whatever is missing
    guess: Guess | None  # where the prediction is least sure
    next_checks: tuple[Check, ...]  # of the instrument, before the next runs
    next_tests: tuple[NextTest, ...]  # that tell what is missing
    surer_runs: tuple[SurerRun, ...]  # that serve the prediction, where this is the goal
    fit: Fit  # of the named effects, under the noise alone
    base: Fit  # the same of the base model
    model: WheelSoilModel  # corrected by all effects and a remainder, whatever is named
    #: [N, 3] held-out predictions of the base model, NaN where no value is in use.
    held_out_before: np.ndarray
    held_out_after: np.ndarray  # [N, 3] with the named effects
    doubts: tuple[str, ...]  # mistakes that the table looks like
    #: How a dense table was binned, "" for any other; then readings that could be meant as well.
    taken: tuple[str, ...]
    settings: Settings

    @property
    def verdict(self) -> str:
        """named, partly, ambiguous, unlisted, none or undetermined.

        The verdict of the probabilities (`Finding.verdict`), with one exception. Named effects are
        `partly` what is missing if a remainder is stated in any channel (`remains`).
        """
        said = self.finding.verdict
        return "partly" if said == "named" and any(map(self.remains, self.gap)) else said

    def remains(self, channel: str) -> bool:
        """True if the report states that the named effects leave a remainder in a channel.

        It does if their held-out error is more than `LEFT` times the noise, or larger than that of
        the base model by more than `WORSE`.
        """
        gap = self.gap[channel]
        return gap.after > LEFT * gap.noise_floor or gap.after > (1.0 + WORSE) * gap.before

    @property
    def base_model(self) -> WheelSoilModel:
        """The calibrated base model: the soil of the fit `base`, without effects."""
        return model_of(self.problem, (), self.base.parameters())

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels with a value in use, in the order of `CHANNELS`."""
        return self.problem.channels

    @property
    def law_error(self) -> float:
        """Relative error of the stress laws that the table suggests: root mean square over its
        posterior in the stated hypothesis.
        """
        return self.finding.stated.evidence.typical("law")

    def known(self, name: str) -> bool:
        """True if the setup gives a soil parameter as known; of the density, if it gives it at
        all.
        """
        return name in self.problem.known or (
            name == "density" and self.problem.data.setup.soil.density is not None
        )

    def is_free(self, effect: str, parameter: str) -> bool:
        """True if a parameter of a named effect was fitted, not set by form or table. One that was
        fitted and whose interval has no width is at a bound of its range.
        """
        return f"{effect}_{parameter}" in self.fit.parameters()

    @property
    def left_out(self) -> list[tuple[int, str]]:
        """(line of the file, channel) of each measured value that was left out as an outlier."""
        at = np.argwhere(self.problem.data.measured & ~self.problem.used)
        return [(int(self.problem.data.table.row[k]), CHANNELS[j]) for k, j in at]
