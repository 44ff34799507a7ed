"""The body and its equations: cells gathered into one tangent with a border."""
