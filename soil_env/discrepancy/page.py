"""report.html: one file that needs nothing else, for a mail or a folder."""

from __future__ import annotations

import base64
from html import escape
from typing import TYPE_CHECKING

from soil_env.discrepancy.formulas import as_html, blocks, validity_line
from soil_env.discrepancy.pictures import pictures
from soil_env.discrepancy.words import (
    EFFECT_COLUMNS,
    SOIL_COLUMNS,
    check_first,
    effect_rows,
    fixed,
    gap_columns,
    gap_rows,
    lesser,
    listed,
    p_value,
    rule,
    soil_rows,
    title,
)

if TYPE_CHECKING:
    from soil_env.discrepancy.workflow import Report

_CSS = """
body{font:15px/1.5 system-ui,-apple-system,"Segoe UI",sans-serif;color:#222;background:#fff;max-width:66rem;
margin:2rem auto;padding:0 1.2rem}
h1{font-size:1.35rem;margin:0 0 .8rem}h2{font-size:1.08rem;margin:2rem 0 .5rem}
p{margin:.4rem 0;max-width:50rem}
.summary{border-left:6px solid #1f6f8b;background:#eef5f7;padding:.8rem 1.1rem;font-size:1.08rem;max-width:none}
.ambiguous,.unlisted{border-color:#c2871a;background:#fbf5e6}
.check{border-color:#b3261e;background:#fbeceb;margin-bottom:.8rem}
.verdict{font-size:.78rem;font-weight:600;letter-spacing:.06em;text-transform:uppercase;color:#555;display:block}
table{border-collapse:collapse;margin:.5rem 0;font-size:.92rem}
th,td{text-align:left;padding:.22rem .9rem .22rem 0;border-bottom:1px solid #ddd;vertical-align:top}
th{font-weight:600;border-bottom:1.5px solid #888}
.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}
h3{font-size:.98rem;margin:1rem 0 .3rem}
.eq{font:1.12rem/1.5 Cambria,"STIX Two Text","Times New Roman",serif;margin:.2rem 0 .2rem 1.2rem;max-width:none}
.eq sub,.eq sup{font-size:.72em;line-height:0}
figure{margin:1rem 0}img{max-width:100%;height:auto;display:block}
ul{margin:.3rem 0;padding-left:1.2rem;max-width:50rem}
.small{color:#555;font-size:.88rem}code{font-size:.88em}
@media print{body{margin:0;max-width:none}h2{break-after:avoid}img,table{break-inside:avoid}}
"""
_CAPTIONS = {
    "predicted": "Held-out predictions against the measured values; grey: twice the noise.",
    "slip": "Measured values and models over slip, in a few groups of rows that differ in slip alone, from where "
    "the base model does best (top) to where it does worst. A red cross was left out as an outlier.",
    "residual": "Held-out residuals over slip in standard deviations of the noise; grey: twice the noise.",
    "ranking": "Gain of held-out likelihood by each candidate over the base model. Dark: named; light: its "
    "alternatives; grey: neither.",
}


def page(report: Report, content: dict) -> str:
    """The page; `content` is `report.as_dict()`."""
    images = {name: _image(name, svg) for name, svg in pictures(report).items()}
    s = content["settings"]
    parts = [
        "<!doctype html>", '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(_heading(report))}</title><style>{_CSS}</style></head><body>",
        "<h1>Wheel and soil: simulation against measurement</h1>",
        f'<p class="summary {report.verdict}"><span class="verdict">{report.verdict}</span>'
        f"{escape(content['summary'])}</p>",
        f'<p class="small">{escape(s["data"])}: {content["rows"]} rows, {int(report.problem.used.sum())} values in '
        "use.</p>",
    ]  # fmt: skip
    first = check_first(report)
    if first:
        text = " ".join(escape(line) for line in first)
        at = next(k for k, part in enumerate(parts) if part.startswith('<p class="summary'))
        parts.insert(at, f'<p class="summary check"><span class="verdict">check first</span>{text}</p>')
    if report.effects:
        parts += [
            "<h2>What is missing</h2>",
            _table(EFFECT_COLUMNS, effect_rows(report)),
        ]
    if report.model.residual:
        parts.append("<h2>A law for what is missing</h2>")
    parts += [as_html(block) for block in blocks(report)]
    if content["where"]:
        parts += [
            "<h2>Where the calibrated base model disagrees</h2>",
            _table(("what", ">p"), [(d["words"], p_value(d["p_value"])) for d in content["where"]]),
            '<p class="small">p: the chance of a disagreement as large as this anywhere in the table.</p>',
        ]
    parts += [
        "<h2>How far the gap closes</h2>",
        _table(gap_columns(report), gap_rows(report)),
        '<p class="small">Root mean square of measured - predicted. Predicted is the mean of what models say that were '
        "fitted without the slip of the value, and without its combination of the other conditions.</p>",
        images["predicted"], images["slip"], images["residual"],
    ]  # fmt: skip
    heading = "How sure the name is" if report.effects else "The candidates"
    parts += [f"<h2>{heading}</h2>", *_sure(report), images["ranking"]]
    parts.append(
        _table(
            ("effect", ">held-out gain [nats]", ">probability"),
            [(title(r.name), fixed(r.score, 1), fixed(r.probability, 3)) for r in report.ranking],
        )
    )
    other = report.other
    parts.append(
        f'<p class="small">Probability that nothing is missing {other["none"]:.3f}, that something is that no '
        f"listed effect explains {other['unlisted']:.3f}. {escape(rule(report))}</p>"
    )
    if content["untestable"]:
        rows = [(title(u["name"]), u["reason"]) for u in content["untestable"]]
        parts += ["<h2>What this table cannot show</h2>", _table(("effect", "reason"), rows)]
    if content["next_tests"]:
        rows = [(t["words"], fixed(t["expected_sigma"], 1)) for t in content["next_tests"]]
        parts += ["<h2>Next tests</h2>", _table(("test", ">expected difference [sd of the noise]"), rows)]
    parts += ["<h2>Soil</h2>", _table(SOIL_COLUMNS, soil_rows(report)),
              f'<p class="small">{escape(validity_line(report))}</p>']  # fmt: skip
    rest = lesser(report)
    if rest:
        parts += ["<h2>Cautions</h2>", _list(rest)]
    parts += ["<h2>How this was made</h2>", *_made(content), "</body></html>"]
    return "\n".join(parts) + "\n"


def _heading(report: Report) -> str:
    names = ", ".join(title(e.name) for e in report.effects)
    return f"{report.verdict}: {names}" if names else report.verdict


def _image(name: str, svg: bytes) -> str:
    data = base64.b64encode(svg).decode("ascii")
    text = escape(_CAPTIONS[name])
    return (
        f'<figure><img alt="{text}" src="data:image/svg+xml;base64,{data}"><figcaption class="small">{text}'
        "</figcaption></figure>"
    )


def _table(columns: tuple[str, ...], rows) -> str:
    """A table; columns whose title starts with ">" hold numbers."""
    number = [c.startswith(">") for c in columns]

    def line(cells, tag):
        return "".join(
            f'<{tag} class="n">{escape(c)}</{tag}>' if n else f"<{tag}>{escape(c)}</{tag}>"
            for c, n in zip(cells, number, strict=True)
        )

    body = "".join(f"<tr>{line(row, 'td')}</tr>" for row in rows)
    head = line([c.lstrip(">") for c in columns], "th")
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _list(lines) -> str:
    return "<ul>" + "".join(f"<li>{escape(text)}</li>" for text in lines) + "</ul>"


def _sure(report: Report) -> list[str]:
    sure = report.sureness
    if sure is None:
        return []
    text = f"With the noise drawn again {sure.draws} times about the corrected model, "
    be = "is" if len(report.effects) == 1 else "are"
    text += f"{listed(title(e.name) for e in report.effects)} {be} found again in {100.0 * sure.share:.1f} %"
    if sure.instead:
        rest = (
            f"{' and '.join(title(n) for n in names)} in {100.0 * share:.1f} %"
            for names, share in list(sure.instead.items())[:4]
        )
        text += f"; instead {', '.join(rest)}"
    return [f"<p>{escape(text)}.</p>"]


def _made(content: dict) -> list[str]:
    s, v = content["settings"], content["versions"]
    noise = "; ".join(f"{k.replace('_', ' ')} {n['sd']:.3g} ({n['origin']})" for k, n in content["noise"].items())
    lines = [
        "The base model was calibrated to the table with the priors of the setup; every candidate was then refitted "
        "together with the soil and judged on held-out groups of conditions.",
        f"Noise, one standard deviation in SI units: {noise}.",
        f"Chance that all there is to see is noise: {p_value(content['chance'])}.",
        f"Data {s['data']}" + (f" (sha256 {s['data_sha256'][:16]}...)" if s["data_sha256"] else "")
        + f", setup {s['setup'] or 'given in memory'}"
        + (f" (sha256 {s['setup_sha256'][:16]}...)" if s["setup_sha256"] else "") + ".",
        f"Seed {s['seed']}, {s['bootstrap']} draws; " + ", ".join(f"{k} {x}" for k, x in v.items()) + ".",
        "Beside this page: report.json (the same in numbers) and model.yaml (the corrected model, for "
        "gymnasium.make(..., model=...); it keeps the conditions that it was fitted to).",
    ]  # fmt: skip
    return [_list(lines)]
