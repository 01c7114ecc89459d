"""Records of compiled code: none begins like another, which numba would take it for."""

import pkgutil
from importlib import import_module

import numpy as np

import soil_env
from soil_env._compiled.flags import record
from soil_env.simulation.world.terrain import course_dtype

# Packages whose records compiled code reads.
PARTS = tuple(
    f"soil_env.{part}"
    for part in ("_compiled", "terramechanics", "simulation", "identification.online")
)


def records():
    """{name: fields with their types and offsets} of all records."""
    # The record of a course is made for its sizes, so that no module holds it.
    found = {"COURSE": course_dtype(1, 1, 1)}
    for module in pkgutil.walk_packages(soil_env.__path__, "soil_env."):
        if module.name.startswith(PARTS):
            for name, value in vars(import_module(module.name)).items():
                if isinstance(value, np.dtype) and value.names:
                    found[name] = value
    return {name: [(n, *dtype.fields[n][:2]) for n in dtype.names] for name, dtype in found.items()}


def test_no_field_is_an_attribute_of_records():
    """Uncompiled code would read that."""
    for name, fields in records().items():
        for field, _, _ in fields:
            assert not hasattr(np.record, field), (name, field)


def test_a_field_with_a_shape_is_an_array():
    """NumPy before 2.0 would take the shape 1 for none; `make oldest` runs this with one."""
    dtype = record("a", one=("i8", 1), three=("f8", 3), table=("f8", (2, 1)), bare=("i8",))
    assert [dtype.fields[n][0].shape for n in dtype.names] == [(), (1,), (3,), (2, 1), ()]


def test_fields_are_aligned():
    """Compiled code on a field that is not takes more instructions."""
    for name, fields in records().items():
        for field, dtype, offset in fields:
            assert offset % min(dtype.base.itemsize, 8) == 0 or dtype.base.names, (name, field)


def test_no_record_begins_like_another():
    known = records()
    assert len(known) > 20
    for name, fields in known.items():
        for other, more in known.items():
            assert name == other or more[: len(fields)] != fields, (name, other)
