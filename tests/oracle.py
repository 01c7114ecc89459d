"""The oracle: numbers that the code gave before it was rewritten, and that it has to go on giving.

    pytest tests/test_oracle.py run all cases, compare them with tests/data/oracle.npz python -m
    tests.oracle write tests/data/oracle.npz anew, as results are meant to change python -m
    tests.oracle --only trajectory/,effect/ the same for these cases; the others stay as recorded

A case gives named quantities, each an array of numbers or a text. Cases go through the public
interface alone.
"""

import argparse
import json
import math
from pathlib import Path

import numpy as np

from tests import oracle_cases

FILE = Path(__file__).parent / "data" / "oracle.npz"
TOLERANCE = 1e-9  # of the largest value that a quantity has over the case
SINGLE = 1.2e-7  # the same for float32, whose last digit may be rounded the other way
#: The same for results of an optimiser, which stops elsewhere on another processor or BLAS.
SEARCHED = 1e-4


def tolerance(case: str, values: np.ndarray) -> float:
    """Largest difference from the recorded `values` of a quantity, over their scale."""
    if case.startswith("identification/"):
        return SEARCHED
    return SINGLE if values.dtype == np.float32 else TOLERANCE


def differences(want: np.ndarray, got: np.ndarray) -> np.ndarray:
    """|got - want| over the scale of the quantity: the largest |want| along the first axis; inf
    where one is nan.
    """
    want = np.asarray(want, float)
    got = np.asarray(got, float)
    scale = np.max(np.abs(np.where(np.isfinite(want), want, 0.0)), axis=0)
    with np.errstate(invalid="ignore"):
        off = np.abs(got - want) / np.where(scale > 0.0, scale, 1.0)
    off = np.where(got == want, 0.0, np.where(np.isnan(got) & np.isnan(want), 0.0, off))
    return np.where(np.isnan(off), math.inf, off)


def first_difference(case: str, want: dict, got: dict) -> str | None:
    """One line on the earliest value of a case that is not the recorded one; None if all are.

    More may have come.
    """
    missing = [name for name in want if name not in got]
    if missing:
        return f"{case}: {len(missing)} quantities are missing, the first {missing[0]!r}"
    found = []
    for name, old in want.items():
        new = got[name]
        if isinstance(old, str) or isinstance(new, str):
            if old != new:
                found.append((-2, 0.0, f"{case}: {name}: {new!r} instead of {old!r}"))
        elif old.shape != new.shape or old.dtype != new.dtype:
            text = f"{new.dtype}{list(new.shape)} instead of {old.dtype}{list(old.shape)}"
            found.append((-1, 0.0, f"{case}: {name}: {text}"))
        else:
            off = differences(old, new)
            limit = tolerance(case, old)
            wrong = np.argwhere(off > limit)
            if len(wrong):
                rows = wrong[wrong[:, 0] == wrong[0, 0]]  # of the first time, the worst
                at = tuple(max(rows.tolist(), key=lambda i: off[tuple(i)]))
                when = f" (control period {int(want['period'][at[0]])})" if "period" in want else ""
                found.append(
                    (
                        at[0],
                        -off[at],
                        (
                            f"{case}: {name} at {list(at)}{when}: {new[at]:.15g} instead of "
                            f"{old[at]:.15g}, relative difference {off[at]:.2g}, tolerance "
                            f"{limit:.1g}"
                        ),
                    )
                )
    return min(found)[2] if found else None


def save(results: dict) -> None:
    """Write the file: all numbers in two arrays, and an index of them in JSON with the texts."""
    index = {}
    parts = {"float32": [], "float64": []}
    for case, quantities in results.items():
        index[case] = {}
        for name, value in quantities.items():
            if isinstance(value, str):
                index[case][name] = value
            else:
                parts[value.dtype.name].append(value.ravel())
                index[case][name] = [value.dtype.name, *value.shape]
    arrays = {kind: np.concatenate([np.empty(0, kind), *values]) for kind, values in parts.items()}
    np.savez_compressed(FILE, index=np.frombuffer(json.dumps(index).encode(), np.uint8), **arrays)


def recorded() -> dict:
    """{case: {quantity: array or text}} of the file."""
    with np.load(FILE) as data:
        index = json.loads(data["index"].tobytes())
        numbers = {k: data[k] for k in ("float32", "float64")}
    at = {"float32": 0, "float64": 0}
    results = {}
    for case, quantities in index.items():
        results[case] = {}
        for name, value in quantities.items():
            if not isinstance(value, str):
                kind, *shape = value
                size = math.prod(shape)
                value = numbers[kind][at[kind] : at[kind] + size].reshape(shape)
                at[kind] += size
            results[case][name] = value
    return results


def main() -> None:
    """Record all cases, or those that are named."""
    p = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    p.add_argument(
        "--only", default="", help="cases whose names contain one of these, with commas between"
    )
    only = p.parse_args().only.split(",")
    old = recorded() if any(only) else {}
    chosen = {case: any(part in case for part in only) for case in oracle_cases.CASES}
    save({case: run() if chosen[case] else old[case] for case, run in oracle_cases.CASES.items()})
    print(f"{FILE}: {sum(chosen.values())} of {len(chosen)} cases made anew")


if __name__ == "__main__":
    main()
