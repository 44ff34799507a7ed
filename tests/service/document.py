"""The OpenAPI document, as tests read it."""


def document(http):
    """Return the document with each reference replaced by the schema that it refers to."""
    whole = http.get("/openapi.json").json()

    def resolved(node):
        if isinstance(node, list):
            return [resolved(item) for item in node]
        if not isinstance(node, dict):
            return node
        rest = {key: resolved(one) for key, one in node.items() if key != "$ref"}
        if "$ref" not in node:
            return rest
        result = whole
        for name in node["$ref"].removeprefix("#/").split("/"):
            result = result[name]
        return resolved(result) | rest

    return resolved(whole)
