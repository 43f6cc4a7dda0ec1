"""Every study runs and answers its question: in its short form, within seconds."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support import ROOT

pytestmark = pytest.mark.weekly
SHARED = {"accuracy_formulas.py", "stored.py"}
"""What studies and tests share, and is no study."""
STUDIES = sorted(path for path in (ROOT / "studies").glob("*.py") if path.name not in SHARED)
PICTURES = {"readme_picture.py"}
"""Studies that draw what the documentation shows, and are asked nothing."""

ANSWERS = {
    "bench_endurance.py": "Does the bench last a day? Yes",
    "bench_in_real_time.py": "at the pace of reality, however long its rests are? Yes.",
    "bench_interruptions.py": "on when the bench is killed? No.",
    "array_sessions.py": "Is any session of the board refused, or a chip of it? No.",
    "aliased_turns.py": "Does u contain what instantaneous samples do to jerky turns? Yes",
    "chip_priors.py": "Are the accel.quadratic terms of these chips as small as the table has them? No",
    "choice_of_positions.py": "lead to the paper's nine? Yes, up to signs",
    "coverage_of_limits.py": "Does a device at its limit pass in 2.5 % at most? Yes",
    "cube_accessories.py": "The plate biases and scale factors; a wedge, a vee or a nest the angles",
    "damaged_inputs.py": "Does a damaged input end otherwise than it should? No.",
    "departures.py": "accepted without a word? Only what no turn of the session shows.",
    "ellipsoid_sizes.py": "Is u of the ellipsoid method honest where rests show how large groups are? Yes",
    "faults.py": "Does a fault of the machine end otherwise than it should? No.",
    "device_types.py": "Is a type of three units or more an honest prior? Yes",
    "field_check.py": "Does a check find these changes in 90 %, and in 1 % one that is none? Yes",
    "formulas_against_simulation.py": "Do the formulas predict the simulation? yes",
    "joint_bound.py": "Does the joint estimate reach the bound? yes",
    "kalman_filter.py": "Does the Kalman filter win? In accuracy",
    "log_guesses.py": "Is a wrong guess said? Yes",
    "metropolis.py": "Is the posterior what a sampler finds? ",
    "noise_processes.py": "Are the right processes named, and are the intervals honest? Yes",
    "over_temperature.py": "Is u over temperature honest, and does a warm-up cost little? Yes",
    "paper_device.py": "Do the published tables come out? Mostly.",
    "populations.py": "Is u honest beyond the data sheet? Yes",
    "platform_drift.py": "Does the drift of the platform win? No",
    "registry_interruptions.py": "Does a registry lose anything when its writer is killed? No.",
    "rest_noise.py": "too small, and the scatter between rests has to be estimated.",
    "sequential_against_scalar.py": "When is the scalar method better? After one pass from ±",
    "table_errors_as_unknowns.py": "Is anything gained by the tilts as unknowns? No: converged, it is the scalar",
    "thermometers_apart.py": "Does each chip need its own thermometer? Yes",
    "tuning.py": "and u honest, with the thresholds as they are? Yes",
    "watched_days.py": "Does a watch alarm no oftener than it says, and find these changes? Yes",
    "verdicts_by_group.py": "Does what is spared hold? Yes",
    "which_method_when.py": "Which method, when? joint wherever there are gyros and turns",
}
"""What the last line of a study says."""
ON_RECORDINGS = {"array_sessions.py", "chip_priors.py"}
"""Studies that want the recordings."""
FALLS_SHORT = {
    "metropolis.py": "u agrees with a sampler within 8 %, not 5 %: root mean square 2 %",
}


def test_every_study_is_known() -> None:
    assert {path.name for path in STUDIES} - PICTURES == set(ANSWERS)


@pytest.fixture
def _known(request: pytest.FixtureRequest) -> None:
    """Studies whose answer does not hold, with the reason."""
    reason = FALLS_SHORT.get(request.getfixturevalue("path").name)
    if reason is not None:
        request.applymarker(pytest.mark.xfail(strict=False, reason=reason))


@pytest.mark.usefixtures("_known")
@pytest.mark.parametrize("path", [p for p in STUDIES if p.name not in PICTURES], ids=lambda path: path.stem)
def test_study_ends_with_its_answer(path: Path, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    environment = os.environ | {"PYTHONIOENCODING": "utf-8"}
    if path.name in ON_RECORDINGS:
        environment["TUMBLE_DATA"] = str(request.getfixturevalue("data"))
    done = subprocess.run(
        [sys.executable, "-W", "error", str(path), "--short"],
        capture_output=True,
        encoding="utf-8",
        check=False,
        timeout=120,
        cwd=tmp_path,
        env=environment,
    )
    assert done.returncode == 0, done.stderr
    assert ANSWERS[path.name] in done.stdout.rstrip().splitlines()[-1]


def test_the_picture_of_the_readme_shows_what_it_says(tmp_path: Path) -> None:
    """Drawn anew, it has the errors over u that the example beside it has."""
    study = next(path for path in STUDIES if path.name == "readme_picture.py")
    command = [sys.executable, str(study), str(tmp_path / "picture.svg")]
    environment = os.environ | {"PYTHONIOENCODING": "utf-8"}
    done = subprocess.run(command, capture_output=True, encoding="utf-8", check=False, env=environment)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip().rpartition(": ")[2] in (study.parents[1] / "README.md").read_text(encoding="utf-8")
