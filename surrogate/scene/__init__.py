"""The plan of one simulation's needs of a component, and the table that is cut to it."""
