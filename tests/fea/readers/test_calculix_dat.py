"""What is read of CalculiX: its .dat print, its errors, its progress. No ccx is needed here."""

from pathlib import Path

import pytest

from tests.fea.decks import component
from tests.refusals import assert_told, cases, changed
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.readers import CalculixDat, DeckRun, OutputError, number
from wrenchbook.fea.solve import solve

TOLD = {"point": "REF", "rotation": "ROT"}

# As ccx 2.20 prints it for two increments.
DAT = Path(__file__).with_name("two_increments.dat").read_text("utf-8")
LAST = (-4.225448e-06, -6.915829e-06, -2.565634e-04, 1.568006e-03, -1.029330e-03, 8.619653e-06)

CUTBACKS = """
 iteration 3

 *ERROR: too many cutbacks
 best solution and residuals are in the frd file

"""
NO_SET = """
 *WARNING reading *CLOAD: something small

 *ERROR reading *BOUNDARY: node set FIXD
        has not yet been defined.
 *ERROR reading *BOUNDARY. Card image:
        FIXD,1,3

 *INFO reading *STEP: nonlinear geometric
"""


@pytest.fixture
def run(tmp_path):
    (tmp_path / "printed.txt").write_text(
        " number of equations\n 2166\n number of equations\n 2170\n"
    )
    (tmp_path / "job.dat").write_text(DAT)
    return DeckRun(tmp_path, "job", tmp_path / "printed.txt")


def test_the_motion_of_the_last_time_is_read(run):
    result = CalculixDat().read(run, TOLD)
    assert result.displacement == LAST
    assert result.unknowns == 2170


def test_names_of_sets_are_read_in_any_case(run):
    assert CalculixDat().read(run, {"point": "ref", "rotation": "Rot"}).displacement == LAST


@cases(__file__, "dat")
def test_output_that_lacks_the_motion_is_refused(run, case):
    (run.folder / "job.dat").write_text(changed(DAT, case))
    with pytest.raises(OutputError) as caught:
        CalculixDat().read(run, TOLD)
    assert_told(case, [str(caught.value)])


def test_a_missing_dat_file_is_told(run):
    (run.folder / "job.dat").unlink()
    with pytest.raises(
        OutputError, match=r"no file job\.dat; .* with U for the sets REF and ROT to the step"
    ):
        CalculixDat().read(run, TOLD)


@pytest.mark.parametrize(
    ("word", "value"), [("1.5E+00", 1.5), ("-0.1234567-101", -0.1234567e-101), ("2.5+100", 2.5e100)]
)
def test_a_three_digit_exponent_of_fortran_is_read(word, value):
    assert number(word, "here") == value


def test_errors_are_quoted_and_a_missing_equilibrium_is_recognised(run):
    reader = CalculixDat()
    assert reader.complaint(run) is None
    run.printed.write_text(CUTBACKS)
    result = reader.complaint(run)
    assert result.not_converged
    assert result.quoted == (
        "*ERROR: too many cutbacks best solution and residuals are in the frd file"
    )
    run.printed.write_text(NO_SET)
    result = reader.complaint(run)
    assert not result.not_converged
    assert "node set FIXD has not yet been defined.; *ERROR reading" in result.quoted
    assert "small" not in result.quoted
    assert "INFO" not in result.quoted


@pytest.mark.parametrize(
    "said",
    [
        "*ERROR: increment size smaller than minimum",
        "*ERROR: solution seems to diverge; please try \n automatic incrementation",
        "*ERROR in nonlingeo: max. # of increments reached",
        "*ERROR: too many iterations needed",
    ],
)
def test_each_way_of_not_converging_is_recognised(run, said):
    run.printed.write_text(f"\n {said}\n\n")
    assert CalculixDat().complaint(run).not_converged


def test_a_thousand_errors_are_cut_short(run):
    run.printed.write_text("\n".join(f" *ERROR: element {i} is bad\n" for i in range(1000)))
    assert len(CalculixDat().complaint(run).quoted) < 500


def test_the_progress_is_the_time_within_the_step(run):
    assert CalculixDat().stage(run) is None
    sta = run.folder / "job.sta"
    sta.write_text("SUMMARY OF JOB INFORMATION\n  STEP      INC     ATT  ITRS     TOT TIME\n")
    assert CalculixDat().stage(run) is None
    line = "     1          3     1     5  0.150000E+01  0.750000E+00  0.250000E+00\n"
    sta.write_text(sta.read_text() + line)
    assert CalculixDat().stage(run) == (0.75, "step 1, increment 3, time 0.75")


def scripted(folder, printed, code, dat=DAT):
    """A bundle whose solver prints and writes what ccx would."""
    script = f"open(job + '.dat', 'w').write({dat!r})\nprint({printed!r})\nsys.exit({code})"
    output = {"reader": "calculix-dat", **TOLD}
    return component(folder, script, output=output, moment="spatial")


def test_an_error_is_believed_whatever_the_exit_code_and_the_output(tmp_path):
    with pytest.raises(SolveFailed, match="reported an error") as caught:
        solve(scripted(tmp_path, NO_SET, 0), [0] * 6)
    assert caught.value.kind == "solver_failed"
    with pytest.raises(SolveFailed, match="too many cutbacks") as caught:
        solve(scripted(tmp_path, CUTBACKS, 201), [0] * 6)
    assert caught.value.kind == "not_converged"


def test_a_silent_exit_code_is_a_failure_even_with_output(tmp_path):
    with pytest.raises(SolveFailed, match="exit code 3") as caught:
        solve(scripted(tmp_path, "", 3), [0] * 6)
    assert caught.value.kind == "solver_failed"


def test_a_good_run_is_the_answer(tmp_path):
    result = solve(scripted(tmp_path, "number of equations\n 12", 0), [0] * 6)
    assert tuple(result.displacement) == LAST
    assert result.unknowns == 12
