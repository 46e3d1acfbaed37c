"""Tables, and their Markdown, LaTeX and HTML formats."""

import html
import re
from dataclasses import dataclass

NO_VALUE = "–"
_LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "±": r"$\pm$", "−": r"$-$", "–": "--", "²": r"$^2$",
}  # fmt: skip


@dataclass(frozen=True)
class Entry:
    """One entry of a table."""

    text: str
    bold: bool = False
    link: str = ""  # of the HTML format


@dataclass(frozen=True)
class Table:
    """Table with a header; every row has the length of the header."""

    name: str
    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[Entry, ...], ...]
    note: str = ""

    @property
    def filled(self) -> bool:
        """True if there is a value that is not one of the paper."""
        shown = [k for k, title in enumerate(self.header) if k and not title.startswith("paper")]
        return any(row[k].text not in (NO_VALUE, "null") for row in self.rows for k in shown)

    def markdown(self) -> str:
        r"""Format as Markdown.

        Example:
            >>> print(Table("t", "Sizes", ("", "a|b"), ((Entry("x"), Entry("1", bold=True)),)).markdown())
            **Sizes**
            <BLANKLINE>
            |  | a\|b |
            |:--|--:|
            | x | **1** |
        """

        def line(texts: list[str]) -> str:
            return "| " + " | ".join(texts) + " |"

        rows = [line([escaped(e.text) if not e.bold else f"**{escaped(e.text)}**" for e in row]) for row in self.rows]
        rule = "|:--" + "|--:" * (len(self.header) - 1) + "|"
        parts = [
            f"**{escaped(self.title)}**",
            "",
            line([escaped(text) for text in self.header]),
            rule,
            *rows,
        ]
        return "\n".join([*parts, "", escaped(self.note)] if self.note else parts)

    def latex(self) -> str:
        """Format as LaTeX, with booktabs rules, a caption and a label."""

        def line(texts: list[str]) -> str:
            return " & ".join(texts) + r" \\"

        rows = [line([rf"\textbf{{{_latex(e.text)}}}" if e.bold else _latex(e.text) for e in row]) for row in self.rows]
        return "\n".join(
            [
                r"\begin{table}", r"\centering", rf"\begin{{tabular}}{{l{'r' * (len(self.header) - 1)}}}", r"\toprule",
                line([_latex(text) for text in self.header]), r"\midrule", *rows, r"\bottomrule", r"\end{tabular}",
                rf"\caption{{{_latex(' '.join(filter(None, [self.title + '.', self.note])))}}}",
                rf"\label{{table:{self.name}}}", r"\end{table}",
            ]
        )  # fmt: skip

    def html(self) -> str:
        """Format as HTML; all text is escaped."""
        head = "".join(f"<th>{html.escape(text)}</th>" for text in self.header)
        rows = "".join("<tr>" + "".join(f"<td>{_html(e)}</td>" for e in row) + "</tr>\n" for row in self.rows)
        note = f"<p><small>{html.escape(self.note)}</small></p>" if self.note else ""
        return (
            f'<section id="{html.escape(self.name)}"><h3>{html.escape(self.title)}</h3>\n<div class="scroll"><table>\n'
            f"<thead><tr>{head}</tr></thead>\n<tbody>{rows}</tbody></table></div>{note}</section>"
        )


def _html(entry: Entry) -> str:
    text = f"<b>{html.escape(entry.text)}</b>" if entry.bold else html.escape(entry.text)
    return f'<a href="{html.escape(entry.link)}">{text}</a>' if entry.link else text


def escaped(text: str) -> str:
    r"""Escape the special characters of Markdown.

    Example:
        >>> print(escaped("failed: <b> in modular_obs"))
        failed: \<b> in modular\_obs
    """
    return re.sub(r"([\\|*_<`\[])", r"\\\1", text)


def _latex(text: str) -> str:
    return "".join(_LATEX.get(letter, letter) for letter in text)
