"""What formats of export take beside the calibration."""

from __future__ import annotations

from typing import Any

from tumble.export import target, targets
from tumble.export.kalibr import NoiseDensities
from tumble.lab.certificate import Certificate, Party, Person
from tumble.reduction.noise.wavelet_moments import FilterDensities

FORMATS = targets()
THERMAL = tuple(name for name in FORMATS if name.endswith("-thermal"))
TEXT = tuple(name for name in FORMATS if name != "mat")
NOISE = NoiseDensities(
    accel=FilterDensities(white=1e-3, walk=2e-4, bounds=()),
    gyro=FilterDensities(white=1e-4, walk=2e-5, bounds=("random walk of the gyros: bounded",)),
    rate=200.0,
    source="the longest rest, 0.0–3600.0 s",
)
PARTY = Party(name="Inertial laboratory", city="Braunschweig", country="DE")
CERTIFICATE = Certificate.model_validate(
    {
        "number": "2026-0042",
        "country": "DE",
        "begin": "2026-05-04",
        "end": "2026-05-05",
        "laboratory": PARTY,
        "customer": PARTY,
        "person": (Person(name="N. N."),),
    },
    strict=False,
)


def beside(to: str) -> dict[str, Any]:
    """What `export_calibration` takes beside a calibration without noise densities, and needs for a certificate."""
    given = {"noise": NOISE, "certificate": CERTIFICATE}
    return {name: given[name] for name in target(to).takes if name in given}
