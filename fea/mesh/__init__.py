"""The mesh: points, cells, facets and groups, and the quality of its cells."""
