"""Compile the kernel in the build of a wheel or an editable install: surrogate/kernel/build.py.

`KERNEL_PLATFORM`, a key of `PLATFORMS` there, makes the wheel of another platform.
"""

from __future__ import annotations

import importlib.util
import os
import sysconfig
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

KERNEL = Path("surrogate") / "kernel"


class CustomBuildHook(BuildHookInterface):
    """Compiles the kernel next to its sources, and adds it to the wheel."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile the kernel, and set the platform of the wheel."""
        build = _load(Path(self.root) / KERNEL / "build.py")
        platform = os.environ.get("KERNEL_PLATFORM", "")
        if not platform:
            library = build.ready_library()
            platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        else:
            target = build.PLATFORMS[platform]
            library = Path(self.directory) / platform / build.library_path(_system(target)).name
            library.parent.mkdir(parents=True, exist_ok=True)
            build.compile_kernel(library, target)
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{platform}"
        if version != "editable":  # an editable install reads the checkout
            place = f"wrenchbook/{KERNEL.as_posix()}/{library.name}"
            build_data["force_include"][str(library)] = place


def _system(target: str) -> str:
    """Return a target's operating system, a value of `sys.platform`."""
    return "win32" if "windows" in target else "darwin" if "macos" in target else "linux"


def _load(path: Path) -> Any:
    spec = importlib.util.spec_from_file_location("kernel_build", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
