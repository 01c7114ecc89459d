"""The tables and figures of the source paper, recomputed, beside those printed values that are known.

Source: Hutangkabodee, Zweiri, Seneviratne & Althoefer (2006), IJAC 3:244-251. Prints the drawbar pull of the checked
point by every rule of integration, Tables 1 and 3 to 5 and Figs. 2 to 4 and 6 to 9. Four printed results are known and
compared, one drawbar pull and the three parameters of Table 3, with the difference and why; of all others the page says
that the printed digits are not available. Every force comes from the compiled functions that the simulated world uses.
Takes about a minute.
"""

from __future__ import annotations

import sys

from rich.console import Console
from rich.markdown import Markdown

from soil_env._io.commands import command_line, command_parser, folder, leave, whole_number
from soil_env._io.files import check_outputs, make_folder
from soil_env.paper import page
from soil_env.paper.results import compute

_EPILOG = """files:
  DIR/paper.md       the page, with everything that is printed
  DIR/paper/*.png    its figures

examples:
  python -m soil_env.paper
  python -m soil_env.paper --out docs"""


@command_line("soil_env.paper")
def main(arguments: list[str] | None = None) -> int:
    """Command line; exit status."""
    p = command_parser("python -m soil_env.paper", __doc__, _EPILOG)
    p.add_argument(
        "--out", type=folder, metavar="DIR", help="write the page and its figures there (default: print only)"
    )
    p.add_argument(
        "--seed", type=whole_number(), metavar="N", default=0, help="of the noise in Table 5, >= 0 (default 0)"
    )
    options = p.parse_args(arguments)
    if options.out is not None:
        check_outputs(options.out, ["paper.md", *(f"paper/{name}.png" for name in page.CAPTIONS)])
        make_folder(options.out)
    results = compute(options.seed)
    if options.out is not None:
        page.write(results, options.out)
    text = page.markdown(results)
    if sys.stdout.isatty():
        Console().print(Markdown(text))
    else:
        print(text)
    if options.out is not None:
        print(f"written: {options.out / 'paper.md'}, figures in {options.out / 'paper'}")
    sys.stdout.flush()
    return 0


if __name__ == "__main__":
    leave(main())
