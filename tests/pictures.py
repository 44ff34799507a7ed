"""The pictures of README and docs: a drawn figure, a response, and the page in Chromium.

``make pictures`` makes them anew: the figure from what stands here, the others from a server of its
own whose table of `plate_thin` is filled first, a minute or two.
"""

from __future__ import annotations

import base64
import tempfile
from pathlib import Path

import matplotlib

from tests.service.page.chromium import Browser
from wrenchbook import plot
from wrenchbook.service.client import Client
from wrenchbook.service.workers.private import private_server

FOLDER = Path(__file__).parents[1] / "data" / "pictures"
SIZE = (1280, 1010)  # px: the whole of the view
QUALITY = 82  # of the WebP: text stays sharp, the file below 100 kB
WRENCH = "fx=0&fy=0&fz=-1200&mx=25&my=0&mz=0"

STYLE = """
  text { font: 14px system-ui, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif; fill: #1b2430; }
  .head { font-weight: 600; font-size: 15px; }
  .small { font-size: 12.5px; fill: #5a6573; }
  .card { fill: #ffffff; stroke: #cfd5da; }
  .step { fill: #f4f6f8; stroke: #cfd5da; }
  .way { fill: none; stroke: #5a6573; stroke-width: 1.6; marker-end: url(#tip); }
  .wrench { stroke: #b0402a; } .moves { stroke: #1f5fa8; } .part { fill: none; stroke: #1f5fa8; }
  .covered { fill: #e3f3ed; stroke: #0a7457; } .thin { fill: #faf0dc; stroke: #95610a; }
"""


def box(x: int, y: int, width: int, height: int, kind: str) -> str:
    """Draw a box, px."""
    return f'<rect class="{kind}" x="{x}" y="{y}" width="{width}" height="{height}" rx="8"/>'


def words(x: int, y: int, text: str, kind: str = "", anchor: str = "middle") -> str:
    """Draw a line of text, px."""
    return f'<text class="{kind}" x="{x}" y="{y}" text-anchor="{anchor}">{text}</text>'


def way(path: str, kind: str = "") -> str:
    """Draw an arrow along an SVG path, px."""
    return f'<path class="way {kind}" d="{path}"/>'


def machine() -> list[str]:
    """Draw a rigid arm on a plate that bends."""
    return [
        box(10, 14, 226, 272, "card"),
        words(123, 42, "rigid-body simulation", "head"),
        '<g fill="none" stroke="#5a6573" stroke-width="9" stroke-linecap="round">'
        '<path d="M112 186 112 140 164 92 206 110"/></g>',
        '<g fill="#ffffff" stroke="#5a6573" stroke-width="3"><circle cx="112" cy="140" r="8"/>'
        '<circle cx="164" cy="92" r="8"/></g>',
        '<path d="M34 194 H190" stroke="#8a94a0" stroke-width="1.5" stroke-dasharray="3 5"/>',
        '<path class="part" stroke-width="6" d="M34 194 C78 196 88 212 112 212 S146 196 190 194"/>',
        '<path d="M26 186v16M198 186v16" stroke="#5a6573" stroke-width="4"/>',
        words(123, 244, "cut at the interface of", "small"),
        words(123, 262, "the deformable part", "small"),
    ]


def book() -> list[str]:
    """Draw what becomes of a wrench: answered, or solved for the next time."""
    return [
        box(396, 14, 494, 272, "card"),
        words(643, 42, "wrenchbook", "head"),
        box(420, 84, 128, 60, "step"),
        words(484, 110, "does the table"),
        words(484, 128, "cover it?"),
        box(636, 84, 230, 60, "covered"),
        words(751, 110, "interpolate, with an error bar"),
        words(751, 130, "20 µs with 100 solves", "small"),
        way("M548 114 H630"),
        words(590, 106, "yes", "small"),
        box(420, 200, 128, 60, "thin"),
        words(484, 226, "queue a solve"),
        words(484, 246, "202, and a job", "small"),
        way("M484 144 V194"),
        words(498, 174, "no", "small", "start"),
        box(636, 200, 230, 60, "step"),
        words(751, 226, "finite elements"),
        words(751, 246, "seconds", "small"),
        way("M548 230 H630"),
        way("M751 200 V182 Q751 172 741 172 H540 Q530 172 530 162 V150"),
        words(646, 165, "its row enters the table", "small"),
    ]


def figure() -> str:
    """Return the README's figure as SVG."""
    between = [
        way("M240 108 H390", "wrench"),
        words(315, 84, "wrench"),
        words(315, 100, "force, moment", "small"),
        way("M394 216 H244", "moves"),
        words(315, 240, "displacement"),
        words(315, 256, "translation, rotation", "small"),
    ]
    tip = (
        '<marker id="tip" viewBox="0 0 10 10" refX="8" refY="5" markerWidth="7" markerHeight="7" '
        'orient="auto"><path d="M0 0 10 5 0 10z" fill="#5a6573"/></marker>'
    )
    drawn = "\n".join([*machine(), *between, *book()])
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 900 300" role="img" '
        'aria-label="A rigid-body simulation sends a wrench; wrenchbook answers with a '
        'displacement, from its table or by a queued solve">\n'
        f"<style>{STYLE}</style>\n<defs>{tip}</defs>\n"
        f'<rect width="900" height="300" rx="12" fill="#f7f7f5"/>\n{drawn}\n</svg>\n'
    )


def photograph(client: Client) -> bytes:
    """Return the deformed plate as the page shows it, a WebP."""
    with tempfile.TemporaryDirectory() as downloads:
        browser = Browser(Path(downloads))
        try:
            browser.begin(client)
            browser.resize(*SIZE)
            browser.visit("#/c/plate_thin")
            wrench = [float(part.partition("=")[2]) for part in WRENCH.split("&")]
            keep = "sessionStorage.setItem('wrenchbook-wrench-plate_thin', arguments[0])"
            browser.run(keep, str(wrench))
            browser.go("#/c/plate_thin/shape")
            browser.drawn("#shape")
            how = {"format": "webp", "quality": QUALITY}
            taken = browser.driver.execute_cdp_cmd("Page.captureScreenshot", how)
            return base64.b64decode(taken["data"])
        finally:
            browser.close()


def draw_response(client: Client) -> None:
    """Write a response of the filled table with its error band."""
    with matplotlib.rc_context({"svg.hashsalt": "wrenchbook", "svg.fonttype": "none"}):
        wrench = [0.0, 0.0, 0.0, 40.0, 0.0, 0.0]
        axes = plot.response(client, "fz", "uz", component="plate_thin", wrench=wrench)
        axes.set_title("plate_thin under fz, with mx = 40 N·m")
        axes.figure.savefig(FOLDER / "response.svg", metadata={"Date": None}, bbox_inches="tight")


def main() -> None:
    """Write the pictures."""
    FOLDER.mkdir(exist_ok=True)
    (FOLDER / "wrenchbook.svg").write_text(figure(), encoding="utf-8")
    with (
        tempfile.TemporaryDirectory() as folder,
        private_server(Path(folder) / "workspace", solvers=2) as client,
    ):
        for _ in client.fill_until("plate_thin", budget=60):
            pass
        draw_response(client)
        (FOLDER / "page.webp").write_bytes(photograph(client))


if __name__ == "__main__":
    main()
