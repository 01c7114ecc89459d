"""All published forms of the thirteen catalogued effects."""

from __future__ import annotations

from benchmarks.blind.easy.forms_contact import CONTACT_FORMS
from benchmarks.blind.easy.forms_run import RUN_FORMS
from benchmarks.blind.effect import Form

FORMS: list[Form] = [*CONTACT_FORMS, *RUN_FORMS]
EFFECTS = tuple(dict.fromkeys(form.effect for form in FORMS))  # names of the catalogue


def forms_of(effect: str) -> list[Form]:
    """All forms of one effect."""
    return [form for form in FORMS if form.effect == effect]
