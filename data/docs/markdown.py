"""Tables of the generated pages, in Markdown that GitHub and the site both show."""


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> list[str]:
    """Return the lines of a table with an empty line behind it; none without rows."""
    if not rows:
        return []
    lines = [head, tuple("---" for _ in head), *rows]
    cells = [[" ".join(cell.split()).replace("|", r"\|") for cell in line] for line in lines]
    return [f"| {' | '.join(line)} |" for line in cells] + [""]


def check_groups(kind: str, groups: dict[str, tuple[str, ...]], names: set[str]) -> None:
    """Raise ValueError unless each name is in one group."""
    grouped = [name for group in groups.values() for name in group]
    if sorted(grouped) != sorted(names):
        raise ValueError(f"not each {kind} is in one group: {set(grouped) ^ names}")
