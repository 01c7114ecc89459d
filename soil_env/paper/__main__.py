"""Every number that the source paper prints, beside ours.

Source: Hutangkabodee, Zweiri, Seneviratne & Althoefer (2006), IJAC 3:244-251; its numbers are in printed.yaml of this
package. Tables 1 to 5, the drawbar pull and the sentences on cohesion, Figs. 6, 7 and 9, each by the equations as
printed and with the angle of maximum stress of Wong & Reece (1967), from whom the paper takes wheel, sand and measured
points.
"""

from __future__ import annotations

import sys

from rich.console import Console
from rich.markdown import Markdown

from soil_env._io.commands import command_line, command_parser, folder, leave, whole_number
from soil_env._io.files import check_outputs, make_folder
from soil_env.paper import page
from soil_env.paper.compare import compute

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
        "--draws", type=whole_number(1), metavar="N", default=1000, help="of the noise in Table 5 (default 1000)"
    )
    p.add_argument(
        "--seed", type=whole_number(), metavar="N", default=0, help="of the noise in Table 5, >= 0 (default 0)"
    )
    options = p.parse_args(arguments)
    if options.out is not None:
        check_outputs(options.out, ["paper.md", *(f"paper/{name}.png" for name in page.FIGURES)])
        make_folder(options.out)
    results = compute(options.seed, options.draws)
    asked = f"soil-env paper --draws {options.draws} --seed {options.seed}"
    if options.out is not None:
        page.write(results, options.out, f"{asked} --out docs")
        print(f"written: {options.out / 'paper.md'}, figures in {options.out / 'paper'}")
    else:
        text = page.markdown(results, asked)
        Console().print(Markdown(text)) if sys.stdout.isatty() else print(text)
    sys.stdout.flush()
    return 0


if __name__ == "__main__":
    leave(main())
