"""The OpenAPI document, as tests read it."""


def document(http):
    """Return the document with each reference replaced by the schema that it refers to."""
    whole = http.get("/openapi.json").json()

    def resolved(node):
        if isinstance(node, list):
            return [resolved(one) for one in node]
        if not isinstance(node, dict):
            return node
        rest = {key: resolved(one) for key, one in node.items() if key != "$ref"}
        if "$ref" not in node:
            return rest
        found = whole
        for name in node["$ref"].removeprefix("#/").split("/"):
            found = found[name]
        return resolved(found) | rest

    return resolved(whole)
