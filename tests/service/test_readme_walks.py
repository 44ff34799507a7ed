"""The request flows of service/README.md name files that exist."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_every_file_of_a_walk_exists():
    text = (ROOT / "service" / "README.md").read_text()
    walks = text.partition("## Request flow")[2].partition("\n## ")[0]
    named = set(re.findall(r"`((?:\w+/)*\w+\.py)`", walks))
    files = [str(file.relative_to(ROOT)) for file in ROOT.glob("*/**/*.py")]
    assert len(named) > 30
    assert [
        name for name in named if not any(f"/{file}".endswith(f"/{name}") for file in files)
    ] == []
