"""Gravity of a site against normal gravity of its latitude and height."""

from __future__ import annotations

from collections.abc import Iterator

from tumble.earth import normal_gravity
from tumble.recording.session import Site

MILLIGAL = 1e-5  # m/s²
GRAVITY_DOUBTED = 300.0 * MILLIGAL
GRAVITY_REFUSED = 1100.0 * MILLIGAL
"""Anomalies of gravity on Earth reach 300 mGal on land in a few places; nowhere 1,000. The limit lets the value through
that imu_tk takes for its recording, 1,091 mGal more than normal gravity, which published results rest on."""


def gravity_difference(site: Site) -> float | None:
    """Gravity of a site less normal gravity, m/s²; None where the latitude is not known."""
    return None if site.latitude is None else site.gravity - normal_gravity(site.latitude, site.height)


def gravity_said(site: Site) -> str | None:
    """Gravity against normal gravity, in words; None where the latitude is not known."""
    difference = gravity_difference(site)
    if difference is None:
        return None
    said = f"gravity {site.gravity:.6f} m/s^2 is {difference / MILLIGAL:+.0f} mGal from normal gravity"
    if abs(difference) <= GRAVITY_DOUBTED:
        return said
    return f"{said}, more than {GRAVITY_DOUBTED / MILLIGAL:.0f}: look at gravity, latitude_deg and height_m in [site]"


def gravity_refused(site: Site) -> Iterator[str]:
    """Gravity that no place of this latitude has."""
    difference = gravity_difference(site)
    if difference is not None and abs(difference) > GRAVITY_REFUSED:
        yield (
            f"gravity {site.gravity:.6f} m/s^2 is {difference / MILLIGAL:+.0f} mGal from normal gravity, more than "
            f"{GRAVITY_REFUSED / MILLIGAL:.0f}: every scale factor of the accelerometers would be wrong with it; "
            "correct gravity, latitude_deg or height_m in [site], or write gravity_confirmed = true"
        )
