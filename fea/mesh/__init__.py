"""The mesh: points, cells, facets and groups, and how good its cells are."""
