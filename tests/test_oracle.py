"""Results are those of the recorded oracle (tests/oracle.py)."""

import pytest

from tests import oracle, oracle_cases

WANT = oracle.recorded()


def test_every_case_is_recorded():
    assert list(WANT) == list(oracle_cases.CASES)


@pytest.mark.parametrize("case", oracle_cases.CASES)
def test_the_numbers_are_the_recorded_ones(case):
    got = oracle_cases.CASES[case]()
    wrong = oracle.first_difference(case, WANT[case], got)
    if wrong:
        pytest.fail(wrong, pytrace=False)
