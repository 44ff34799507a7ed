"""Where the components that come with the program are."""

from pathlib import Path

# In a checkout a link to data/components, where an engineer expects them.
SHIPPED = (Path(__file__).parents[2] / "components").resolve()
