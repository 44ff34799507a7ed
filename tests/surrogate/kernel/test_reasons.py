"""The codes of reasons and statuses are those of the kernel, and each reason has a text."""

import re

from wrenchbook.surrogate.kernel.build import FOLDER
from wrenchbook.surrogate.kernel.reasons import FIXED, WITH_NUMBERS, Code
from wrenchbook.surrogate.kernel.replies import Status


def test_the_codes_are_those_of_the_header():
    header = (FOLDER / "wrenchbook.h").read_text()
    declared = re.findall(r"WB_REASON_(\w+) = (\d+)", header)
    assert declared == [(code.name, str(code.value)) for code in Code]


def test_the_statuses_are_those_of_the_header():
    header = (FOLDER / "wrenchbook.h").read_text()
    block = header[header.index("WB_OK = 0") : header.index("WB_COVERED")]
    declared = re.findall(r"WB_(\w+) = (\d+)", block)
    assert sorted(declared) == sorted((status.name, str(status.value)) for status in Status)


def test_each_code_has_one_text():
    assert sorted([*FIXED, *WITH_NUMBERS, Code.AXIS_OFF_HULL]) == list(Code)
