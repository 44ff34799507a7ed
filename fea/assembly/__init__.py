"""The body and its equations: cells assembled into one tangent with a border."""
