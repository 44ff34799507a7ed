"""The page at `/` and the calls' documentation at `/docs`, without files of other hosts.

The page's own files are in service/page. The libraries that draw plots and show the calls are
large; they are read from the Python packages plotly and fastapi-offline.
"""

from __future__ import annotations

import gzip
import hashlib
from functools import cache, lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Final

from fastapi import APIRouter, Header, Request
from starlette.responses import RedirectResponse, Response

from wrenchbook.service.http.problems import HttpProblemError
from wrenchbook.service.http.routes import holds, naming

router = APIRouter(include_in_schema=False)

FOLDER: Final = Path(__file__).parents[2] / "page"
MEDIA_TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
}
# Addresses of the pages, relative to /page/: their links are relative to these.
PAGES: Final = {"index.html": "../", "docs.html": "../docs"}
# Package and its file, by the name under which it is served.
BORROWED: Final = {
    "js/pressed.js": ("wrenchbook.fea", "check/pressed.js"),  # `check --plot` has it too
    "plotly.min.js": ("plotly", "package_data/plotly.min.js"),
    "swagger-ui-bundle.js": ("fastapi_offline", "static/swagger-ui-bundle.js"),
    "swagger-ui.css": ("fastapi_offline", "static/swagger-ui.css"),
}


@router.get("/")
def page(request: Request, if_none_match: Annotated[str | None, Header()] = None) -> Response:
    return _file("index.html", request, if_none_match)


@router.get("/docs")
def docs(request: Request, if_none_match: Annotated[str | None, Header()] = None) -> Response:
    return _file("docs.html", request, if_none_match)


@router.get("/page/{name:path}")
def page_file(
    name: str, request: Request, if_none_match: Annotated[str | None, Header()] = None
) -> Response:
    if name in PAGES:
        return RedirectResponse(PAGES[name])
    return _file(name, request, if_none_match)


def _file(name: str, request: Request, if_none_match: str | None) -> Response:
    path = _paths().get(name)
    if path is None:
        why = f"The page has no file {name[:200]!r}. The page is at /, the calls at /docs."
        raise HttpProblemError(404, "no-file", "No such file", why)
    content, tag = _read(path, path.stat().st_mtime_ns)
    headers = {**naming(tag), "Vary": "Accept-Encoding"}
    if holds(if_none_match, tag):
        return Response(status_code=304, headers=headers)
    if "gzip" in request.headers.get("accept-encoding", ""):
        headers["Content-Encoding"] = "gzip"
    else:
        content = gzip.decompress(content)
    return Response(content, 200, headers, MEDIA_TYPES[path.suffix])


@cache
def _paths() -> dict[str, Path]:
    """Return all served files by name; no other file is opened."""
    files = {
        path.relative_to(FOLDER).as_posix(): path
        for path in FOLDER.rglob("*")
        if path.suffix in MEDIA_TYPES and path.is_file()
    }
    for name, (package, inside) in BORROWED.items():
        spec = find_spec(package)
        if spec is not None and spec.origin is not None:
            files[name] = Path(spec.origin).parent / inside
    return files


@lru_cache(maxsize=256)
def _read(path: Path, changed: int) -> tuple[bytes, str]:
    """Return a file, compressed, and the tag of its content; a changed file is read again."""
    content = path.read_bytes()
    tag = hashlib.blake2b(content, digest_size=12).hexdigest()
    return gzip.compress(content, 6, mtime=0), f'"{tag}"'
