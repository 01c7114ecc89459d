"""All forms of the thirteen mechanisms that the benchmark hides, none of them in the fit's catalogue."""

from __future__ import annotations

from benchmarks.blind.effect import Form
from benchmarks.blind.forms_contact import CONTACT_FORMS
from benchmarks.blind.forms_run import RUN_FORMS

FORMS: list[Form] = [*CONTACT_FORMS, *RUN_FORMS]
MECHANISMS = tuple(dict.fromkeys(form.effect for form in FORMS))  # names of the catalogue
#: What must vary in a table for a mechanism to show; the others can be seen in every design.
VARIES = {"multipass": "pass", "penetration_rate": "speed", "shear_rate": "speed", "grade": "grade_deg"}


def forms_of(mechanism: str) -> list[Form]:
    """All forms of one mechanism."""
    return [form for form in FORMS if form.effect == mechanism]
