"""What bad input ends in: one line that says what, where and what was expected."""

import re

import pytest

from soil_env._io.loading import ParameterError


def refused(action, *parts):
    """Message of the `ParameterError` that `action` raises: one line that holds all `parts`."""
    with pytest.raises(ParameterError) as caught:
        action()
    message = str(caught.value)
    assert "\n" not in message and len(message) < 600 and all(part in message for part in parts), (
        message
    )
    return message


def refused_command(capsys, program, run, *arguments):
    """(stdout, stderr) of the command `run(arguments)`, which has to end with status 2 and one line
    on stderr that begins with `program`.
    """
    capsys.readouterr()
    status = run(list(map(str, arguments)))
    shown = capsys.readouterr()
    assert status == 2, shown
    assert re.match(re.escape(program) + r"( [\w-]+)*: error: ", shown.err), shown.err
    assert shown.err.count("\n") == 1, shown.err
    return shown
