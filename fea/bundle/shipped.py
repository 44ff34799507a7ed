"""The folder of the components that the program ships."""

from pathlib import Path

# In a checkout this is a link to data/components, where engineers look for them.
SHIPPED = (Path(__file__).parents[2] / "components").resolve()
