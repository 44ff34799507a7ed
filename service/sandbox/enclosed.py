"""The other side of `program`: hold limits, then be the module that is asked for.

Run as a program with the limits as JSON, the module and its arguments.
"""

from __future__ import annotations

import json
import runpy
import sys

from service.sandbox.limits import Limits, hold


def main(words: list[str]) -> None:
    """Hold limits, then be the program."""
    told, module, *arguments = words
    sys.argv = [module, *arguments]
    hold(Limits(**json.loads(told)))
    runpy.run_module(module, run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main(sys.argv[1:])
