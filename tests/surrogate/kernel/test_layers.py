"""Each file of the kernel calls only those that wb_internal.h declares above it."""

import re

from wrenchbook.surrogate.kernel.build import FOLDER

LAST = ("wb_joint.c",)  # it calls others and none calls it
FUNCTION = re.compile(r"^(?!static)\w[^\n;={}]*?\b(wb_\w+)\([^;{]*\)\s*\{", re.MULTILINE)


def test_each_file_of_the_kernel_calls_only_those_above_it():
    sections = re.findall(r"/\* (wb_\w+\.c) \*/", (FOLDER / "wb_internal.h").read_text())
    order = [*sections, *LAST]
    texts = {path.name: path.read_text() for path in FOLDER.glob("wb_*.c")}
    assert sorted(order) == sorted(texts)
    defined = {name: file for file in order for name in FUNCTION.findall(texts[file])}
    assert len(defined) > 50
    for place, file in enumerate(order):
        called = set(re.findall(r"\b(wb_\w+)\(", texts[file])) & set(defined)
        above = {*order[:place], file} if file not in LAST else {*sections, file}
        assert {name for name in called if defined[name] not in above} == set(), file
