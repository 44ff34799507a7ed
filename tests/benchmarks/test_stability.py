"""The stability table, printed: extreme parts and loads, each right or refused by name."""

from tests.fea import stability


def test_the_stability_table_has_no_wrong_answer_in_silence(capsys):
    lines = list(stability.table())
    with capsys.disabled():
        print("\n" + "\n".join(lines))
    assert not [line for line in lines if " right " in line and " nan" in line]
