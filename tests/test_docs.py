"""README and documentation: links resolve, Python blocks run, commands exist, the site builds.

A block below the line ``<!-- not run: REASON -->`` or ``<!-- run by TEST -->`` is left out. The
Python blocks of a page or the cells of a notebook run in one namespace, against a server with
solvers and an empty data directory. A text block right below a Python block is what that prints.
"""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
import typer

import wrenchbook
from data.docs import generated, licences
from tests.service import remembered
from tests.service.live import served
from tests.slow import slow
from wrenchbook.service.cli.local import PROGRAMS
from wrenchbook.service.cli.main import app
from wrenchbook.service.files.program import child_command
from wrenchbook.service.jobs.solver import SOLVE_VARIABLE

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "data/docs"
PAGES = [
    *(ROOT / name for name in ("README.md", "CHANGELOG.md", "SECURITY.md")),
    *(
        file
        for room in ("fea", "surrogate", "service")
        for file in ROOT.glob(f"{room}/**/README.md")
    ),
    *DOCS.glob("**/*.md"),
]
RUN = [
    ROOT / "README.md",
    *(DOCS / f"concepts/{name}.md" for name in ("coupling", "error-bars", "table", "wrench")),
    *(
        DOCS / f"how-to/{name}.md"
        for name in (
            "batches",
            "compare",
            "cycles",
            "in-process",
            "record",
            "scene",
            "several-inputs",
            "simulators",
            "um-bridge",
        )
    ),
    *sorted(DOCS.glob("tutorials/*.md")),
    *sorted(DOCS.glob("notebooks/*.ipynb")),
]
FENCE = re.compile(r"(?P<before>[^\n]*)\n+^```(?P<kind>\w*)[^\n]*\n(?P<text>.*?)^```", re.M | re.S)


def shown(page: Path) -> str:
    return str(page.relative_to(ROOT))


def blocks(page: Path, *kinds: str) -> Iterator[tuple[int, str]]:
    """The line and the text of the page's code blocks, without those that are not run."""
    text = page.read_text()
    for result in FENCE.finditer("\n" + text):
        if result["kind"] in kinds and not re.match(r"<!-- (not run:|run by) \S", result["before"]):
            yield text[: result.start("text") - 1].count("\n") + 1, result["text"]


def cells(notebook: Path, kind: str) -> Iterator[str]:
    """The texts of the notebook's cells of one kind."""
    for cell in json.loads(notebook.read_text())["cells"]:
        if cell["cell_type"] == kind:
            yield cell["source"]


def python_of(page: Path) -> list[tuple[int, str]]:
    """The lines and texts of a page's Python blocks, or the numbers and texts of its cells."""
    if page.suffix == ".ipynb":
        return [*enumerate(cells(page, "code"), 1)]
    return [*blocks(page, "python")]


def shown_below(page: Path, line: int) -> str | None:
    """The text block that follows the Python block of a line, None without one."""
    below = "".join(page.read_text().splitlines(keepends=True)[line:])
    block = re.match(r".*?^```\n\n```text\n(.*?)^```", below, re.M | re.S)
    return block[1] if block and block[0].count("```") == 3 else None


def parts(text: str) -> tuple[list[str], list[str]]:
    """The words of a text and its numbers."""
    number = r"[-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?"
    return " ".join(re.sub(number, "#", text).split()).split(), re.findall(number, text)


def flips(number: str) -> float:
    """The tolerance of a printed number: a unit of its last digit, at most 5 %; none of a count.

    OpenBLAS for three processors (Haswell, SkylakeX, Prescott) changes the answers of a filled
    table by 2e-12 of the range and its error bars by 3e-9, so that only a last digit may flip.
    """
    digits, _, exponent = number.partition("e")
    if number.lstrip("+-").isdigit():
        return 0.0
    unit = 10.0 ** (int(exponent or 0) - len(digits.partition(".")[2]))
    return min(1.001 * unit, 0.05 * abs(float(number)))


def anchors(page: Path) -> set[str]:
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.M | re.S)
    slugs, result = (
        re.findall(r"^#+ (.*)$", text, re.M),
        set(re.findall(r"^\((\S+)\)=$", text, re.M)),
    )
    for slug in slugs:
        texts = re.sub(r"[^\w\- ]", "", slug.strip().lower().replace("`", ""))
        result.add(texts.replace(" ", "-"))
    return result


def broken_links(page: Path) -> list[str]:
    text = page.read_text() if page.suffix == ".md" else "\n\n".join(cells(page, "markdown"))
    text = re.sub(r"^```.*?^```|`[^`\n]*`", "", text, flags=re.M | re.S)
    broken = []
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        path, _, anchor = link.partition("#")
        target = page.parent / path if path else page
        if re.match(r"[a-z]+:", link):
            continue
        if not target.exists() or (
            anchor and target.suffix == ".md" and anchor not in anchors(target)
        ):
            broken.append(link)
    return broken


def commands(page: Path) -> Iterator[tuple[int, list[str]]]:
    for line, text in blocks(page, "sh", "shell", "bash", "console"):
        for item in text.replace("\\\n", " ").splitlines():
            texts = item.removeprefix("$ ").strip()
            if texts.startswith("wrenchbook "):
                texts = re.split(r" [|>&;]|;", texts)[0]
                yield line, shlex.split(texts, comments=True)[1:]


@cache
def help_of(program: str) -> str:
    command = child_command("wrenchbook.fea.check.commands", program, "--help")
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def parse(texts: list[str]) -> None:
    """Parse a command line as far as that its command and options exist."""
    if texts[0] in PROGRAMS:
        options = [word.partition("=")[0] for word in texts if word.startswith("--")]
        assert [option for option in options if option not in help_of(texts[0])] == []
        return
    command = typer.main.get_command(app)
    context = typer.Context(command, info_name="wrenchbook")
    while hasattr(command, "commands") and texts and not texts[0].startswith("-"):
        command = command.commands[texts.pop(0)]
        context = typer.Context(command, info_name=command.name, parent=context)
    _, rest, _ = command.make_parser(context).parse_args(list(texts))
    assert not rest, f"arguments too many: {rest}"


@pytest.mark.parametrize("page", [*PAGES, *DOCS.glob("notebooks/*.ipynb")], ids=shown)
def test_every_link_of_a_page_leads_to_a_file_and_a_heading(page):
    assert broken_links(page) == []


@pytest.mark.parametrize("page", PAGES, ids=shown)
def test_the_commands_of_a_page_exist_with_their_options(page):
    for line, text in commands(page):
        try:
            parse(text)
        except Exception as error:  # of click, whose copy typer carries
            pytest.fail(f"{shown(page)}:{line}: wrenchbook {shlex.join(text)}: {error!r}")


def test_every_other_python_block_says_why_it_is_not_run_here():
    left = [shown(page) for page in PAGES if page not in RUN and [*blocks(page, "python")]]
    assert left == []


@pytest.fixture
def float32_of_jax():
    """Restore the precision of JAX, which a page sets for the process."""
    yield
    if "jax" in sys.modules:
        sys.modules["jax"].config.update("jax_enable_x64", False)


@pytest.fixture(scope="module")
def solves(tmp_path_factory):
    """Solve each wrench once, though many pages fill the same table from empty."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(remembered.FOLDER, str(tmp_path_factory.mktemp("solves")))
        patch.setenv(SOLVE_VARIABLE, f"{remembered.__name__}:solve")
        patch.setenv("PYTHONPATH", str(ROOT), prepend=os.pathsep)
        yield


@pytest.mark.usefixtures("float32_of_jax", "solves")
@pytest.mark.parametrize("page", RUN, ids=shown)
def test_the_python_of_a_page_runs_in_order_and_prints_what_the_page_shows(
    page, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    (tmp_path / "data").symlink_to(ROOT / "data")
    with served(tmp_path / "workspace", solvers=2) as client:
        monkeypatch.setenv("WRENCHBOOK_SERVER", client.url)
        namespace: dict = {"__name__": "tutorial"}
        for line, text in python_of(page):
            text = "\n" * line + text.replace("http://127.0.0.1:8000", client.url)
            capsys.readouterr()
            exec(compile(text, shown(page), "exec"), namespace)
            below = shown_below(page, line) if page.suffix == ".md" else None
            if below:
                (words, numbers), (printed, values) = parts(below), parts(capsys.readouterr().out)
                assert printed == words
                assert [*map(float, values)] == [
                    pytest.approx(float(number), rel=0, abs=flips(number)) for number in numbers
                ]
        for value in namespace.values():
            if isinstance(value, wrenchbook.Client):
                value.close()


@pytest.fixture(scope="module")
def filled(tmp_path_factory, solves):
    """The table of `plate_thin`, filled from empty."""
    with served(tmp_path_factory.mktemp("filled"), solvers=2) as client:
        for _ in client.fill_until("plate_thin"):
            pass
        yield client.download("plate_thin")


@pytest.mark.parametrize(
    ("page", "wrench", "shown"),
    [
        ("c", [150, -100, -600, 10, 20, 5], r"^covered kriging\n.*\n.*\n(\S+) (\S+)$"),
        ("fmu", [120, -70, -500, 12, 18, 4], r"^\(0\.01, (\S+), (\S+), 0\)$"),
        ("tolerance", [0, 0, -400, 0, 0, 0], r"^│ uz │ +(\S+) │ +(\S+) │ m"),
    ],
)
def test_the_displacement_below_a_command_is_that_of_a_filled_table(filled, page, wrench, shown):
    numbers = re.search(shown, (DOCS / f"how-to/{page}.md").read_text(), re.M)
    assert numbers
    answer = filled.answer(wrench)
    values = answer.translation[2], answer.error_translation[2]
    assert values == pytest.approx([*map(float, numbers.groups())], rel=1e-5)


@pytest.mark.parametrize("page", [*PAGES[2:], *DOCS.glob("notebooks/*.ipynb")], ids=shown)
def test_the_first_line_of_a_page_says_for_whom_it_is(page):
    text = page.read_text() if page.suffix == ".md" else next(cells(page, "markdown"))
    assert text.split("\n\n")[1].startswith("For ")


@pytest.mark.parametrize(
    "page",
    [
        page
        for part in ("concepts", "how-to", "tutorials", "notebooks")
        for page in DOCS.glob(f"{part}/*")
        if page.suffix in (".md", ".ipynb")
    ],
    ids=shown,
)
def test_the_last_paragraph_of_a_page_names_the_next_step(page):
    text = page.read_text() if page.suffix == ".md" else [*cells(page, "markdown")][-1]
    assert text.rstrip().rpartition("\n\n")[2].startswith("Next: ")


def test_the_licences_are_those_of_the_locked_packages():
    before = licences.PAGE.read_text()
    assert dict(licences.ROW.findall(before)).keys() == set().union(
        *map(licences.locked, licences.LOCKS)
    )
    if sys.version_info[:2] == (3, 11):  # newer ones have other versions in the lock
        assert licences.page(before) == before, "write the page anew: make licences"


@pytest.mark.parametrize("page", generated.TABLES)
def test_the_tables_of_the_reference_are_those_of_the_program(page):
    text = (DOCS / f"reference/{page}.md").read_text()
    assert generated.with_table(page) == text, "write the page anew: make reference"


def test_the_reference_has_every_public_name():
    headings = anchors(DOCS / "reference/python.md")
    errors = (DOCS / "reference/python.md").read_text().partition("\n## Errors\n")[2]
    assert [
        name
        for name in wrenchbook.__all__
        if name != "__version__" and name.lower() not in headings and f"`{name}`" not in errors
    ] == []


def test_the_tests_that_the_threats_name_exist():
    page = (DOCS / "reference/threats.md").read_text()
    named = re.findall(r"`(?:\w+/)*(test_\w+\.py)(?:::(\w+))?`", page)
    missing = [
        (file, name)
        for file, name in named
        if not any(f"def {name}" in path.read_text() for path in ROOT.glob(f"tests/**/{file}"))
    ]
    assert missing == []


@pytest.mark.parametrize("notebooks", ["off", slow("force")])  # run by the test above too
def test_the_site_builds_without_a_warning_and_loads_nothing_from_another_host(tmp_path, notebooks):
    missing = [name for name in ("sphinx", "myst_nb", "furo") if not importlib.util.find_spec(name)]
    if missing and not os.environ.get("CI"):
        pytest.skip(f"{', '.join(missing)} not installed: make docs installs them")
    subprocess.run(
        [sys.executable, "-m", "sphinx", "-q", "-W", "-c", DOCS, ROOT, tmp_path / "site"],
        env=os.environ | {"DOCS_NOTEBOOKS": notebooks},
        check=True,
    )
    loaded = re.compile(
        r"<(?:script|img|iframe|source)\b[^>]*\bsrc=[\"']?(?:https?:)?//[^\"'>]*"
        r"|<link\b[^>]*\brel=[\"'](?:stylesheet|preload|icon|preconnect)[^>]*href=[\"'](?:https?:)?//[^>]*"
    )
    pages = [*(tmp_path / "site").rglob("*.html")]
    assert len(pages) > 10
    assert [result for page in pages for result in loaded.findall(page.read_text())] == []
    styles = [*(tmp_path / "site").rglob("*.css")]
    assert [
        page.name
        for page in styles
        if re.search(r"url\([\"']?(?:https?:)?//|@import [\"'](?:https?:)?//", page.read_text())
    ] == []


@pytest.mark.parametrize("file", ["CITATION.cff", "data/docs/citation.md"])
def test_the_version_of_a_citation_is_that_of_the_program(file):
    assert re.search(r"^ *version *[:=] *\{?([\d.]+)", (ROOT / file).read_text(), re.M)[1] == (
        wrenchbook.__version__
    )
