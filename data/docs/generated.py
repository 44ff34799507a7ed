"""Generated Markdown: the reference of commands, HTTP calls and names, and the site's navigation.

``make reference`` writes the reference below the introductions of its pages.
"""

import re
from pathlib import Path

from data.docs.calls import calls
from data.docs.commands import commands
from data.docs.names import names

FOLDER = Path(__file__).parent
TABLES = {"cli": commands, "http": calls, "python": names}
"""The text of the pages of the reference, below their introductions."""


def with_table(page: str) -> str:
    """Return the text of a page of the reference with its generated part written anew."""
    introduction = (FOLDER / f"reference/{page}.md").read_text().partition("\n## ")[0]
    return "\n".join([introduction.rstrip(), "", *TABLES[page]()]).rstrip() + "\n"


def navigation() -> str:
    """Return the site's navigation: the tables of index.md, their first header as the caption.

    A link to a section is left out, a page of two tables is in the first.
    """
    lines, seen = [], set()
    for table in re.findall(r"(?:^\|.*\n)+", (FOLDER / "index.md").read_text(), re.M):
        caption = table.strip("| \n").partition(" |")[0].capitalize()
        lines += ["", "```{toctree}", f":caption: {caption}", ":maxdepth: 1", ":hidden:", ""]
        for text, page in re.findall(r"\[([^\]]+)\]\(([^)#]+)\.(?:md|ipynb)\)", table):
            if page not in seen:
                lines.append(f"{text} <{page}>" if page.endswith("README") else page)
            seen.add(page)
        lines.append("```")
    return "\n".join([*lines, ""])


if __name__ == "__main__":
    for name in TABLES:
        (FOLDER / f"reference/{name}.md").write_text(with_table(name))
