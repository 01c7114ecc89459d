"""Load and store of records, generated from the fields of their named tuples.

    load, store, choose, same = lane_record(Reaction)      # compiled functions

`load(rows, i)` is a record of lanes from the columns i ... i + 7 of rows that have the names of its fields;
`store(values, rows, i)` writes them; `choose(mask, a, b)` takes each field of `a` where the mask is 1, else of `b`;
`same(x)` has `x` in each field.
"""

from typing import Any, NamedTuple

from soil_env._numba.compiling import compiled_inline
from soil_env._numba.elementary import chosen
from soil_env._numba.lanes import from_array, to_array


class LaneRecord(NamedTuple):
    """Compiled access to one kind of record, in rows of lanes."""

    load: Any
    store: Any
    choose: Any
    same: Any


class RowRecord(NamedTuple):
    """Compiled access to one kind of record, in a row of numbers [fields]."""

    load: Any
    store: Any


def lane_record(record: type) -> LaneRecord:
    """Access to a named tuple of lanes."""
    fields = record._fields
    return LaneRecord(
        _compiled(record, "load(rows, i)", [f"from_array(rows.{f}, i)" for f in fields]),
        _compiled(
            record,
            "store(values, rows, i)",
            [f"to_array(values.{f}, rows.{f}, i)" for f in fields],
            False,
        ),
        _compiled(record, "choose(mask, a, b)", [f"chosen(mask, a.{f}, b.{f})" for f in fields]),
        _compiled(record, "same(x)", ["x" for _ in fields]),
    )


def row_record(record: type) -> RowRecord:
    """Access to a named tuple of numbers."""
    fields = record._fields
    return RowRecord(
        _compiled(record, "load(row)", [f"row[{k}]" for k in range(len(fields))]),
        _compiled(
            record,
            "store(values, row)",
            [f"row[{k}] = values.{f}" for k, f in enumerate(fields)],
            False,
        ),
    )


def _compiled(record: type, head: str, parts: list[str], returns: bool = True):
    """The compiled function `head` that makes a record of its parts, or executes them."""
    body = (
        f"    return record({', '.join(parts)})"
        if returns
        else "\n".join(f"    {part}" for part in parts)
    )
    names = {"record": record, "from_array": from_array, "to_array": to_array, "chosen": chosen}
    names["__name__"] = record.__module__
    exec(f"def {head}:\n{body}\n", names)  # as `typing.NamedTuple` itself does
    return compiled_inline(names[head.partition("(")[0]])


@compiled_inline
def keep_where(mask, value, row, i):
    """Store `value` into lanes i ... i + 7 of a row where the mask is 1."""
    to_array(chosen(mask, value, from_array(row, i)), row, i)
