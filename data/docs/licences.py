"""Write the page of licences from the lock files and the installed packages: ``make licences``."""

import re
from importlib import metadata
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "data/docs/reference/licences.md"
LOCKS = {
    "requirements.lock": "The program: extra `server`, and its build",
    "requirements-cluster.lock": "Dask workers: extra `cluster`",
    "requirements-docs.lock": "The documentation's site: extra `docs`",
    "requirements-dev.lock": "Tests, and the extras `cad`, `mujoco`, `jax`, `fmu`, `rig`",
}
ROW = re.compile(r"^\| `([^`]+)` \| (.+) \|$", re.M)
HEAD = """# Licences

For everybody who packages or reviews wrenchbook: the licence of each package of the lock files, as
its metadata states it. `make licences` writes this page.

wrenchbook is under the MIT licence. Its wheel holds one text by others: the headers of the FMI
standard (`service/fmu/c/fmi2*.h`, Modelica Association, 2-clause BSD). Each exported FMU holds them
too. All packages below are installed beside wrenchbook and are not part of it.
The wheel without extras installs NumPy alone.

- gmsh (extra `cad`) is under the GPL. wrenchbook runs it in a child process.
- npTDMS (extra `rig`) and paramiko (extra `replica`) are under the LGPL.
- Drake, which the tests alone use, installs MOSEK. MOSEK is proprietary; no test calls it.
- The extras `replica` (s3fs, paramiko) and `torch` are in no lock file: see these packages.
"""


def locked(lock: str) -> set[str]:
    """Return the names in a lock file."""
    return set(re.findall(r"^([\w.-]+)==", (ROOT / lock).read_text(), re.M))


def licence(name: str) -> str | None:
    """Return the licence in a package's metadata, or None if the package is not installed."""
    try:
        package = metadata.metadata(name)
    except metadata.PackageNotFoundError:
        return None
    classifiers = package.get_all("Classifier") or []
    named = [text.rpartition(" :: ")[2] for text in classifiers if text.startswith("License ::")]
    text = (package.get_all("License") or [""])[0].strip()
    short = text if "\n" not in text and 0 < len(text) < 40 and text != "UNKNOWN" else ""
    expression = (package.get_all("License-Expression") or [""])[0]
    return expression or ", ".join(named) or short or "see the package"


def page(before: str) -> str:
    """Return the page; a package that is not installed, as of another platform, keeps its line."""
    known, listed, lines = dict(ROW.findall(before)), set(), [HEAD]
    for lock, title in LOCKS.items():
        names = locked(lock) - listed
        listed |= names
        lines += [f"## {title}", "", "| package | licence |", "|---|---|"]
        unknown = "installs on other platforms: see the package"
        lines += [
            f"| `{name}` | {licence(name) or known.get(name, unknown)} |" for name in sorted(names)
        ]
        lines.append("")
    return "\n".join(lines)


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text() if PAGE.exists() else ""))
