"""List the benchmarks: ``make bench``."""

import ast
from pathlib import Path

for path in sorted(Path(__file__).parent.glob("test_*.py")):
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    name = path.stem.removeprefix("test_")
    print(f"make bench NAME={name:14} {' '.join(text.split('.')[0].split())}")
