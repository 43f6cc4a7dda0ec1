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


def gravity_said(site: Site) -> str:
    """Gravity, and where the latitude is known how far from normal gravity."""
    difference = gravity_difference(site)
    against = "" if difference is None else f", {difference / MILLIGAL:+z.0f} mGal from normal gravity"
    return f"gravity {site.gravity:.6f} m/s^2{against}"


def gravity_doubted(site: Site) -> tuple[str, ...]:
    """Gravity that few places have, as a note."""
    difference = gravity_difference(site)
    if difference is None or abs(difference) <= GRAVITY_DOUBTED:
        return ()
    return (
        f"{gravity_said(site)}, more than {GRAVITY_DOUBTED / MILLIGAL:.0f}: look at gravity, latitude_deg and height_m "
        f"in [site]; if that is wrong, the scale factors of the accelerometers are off by "
        f"{difference / site.gravity * 1e6:+.0f} ppm",
    )


def gravity_refused(site: Site) -> Iterator[str]:
    """Gravity that no place of this latitude has."""
    difference = gravity_difference(site)
    if difference is not None and abs(difference) > GRAVITY_REFUSED:
        yield (
            f"{gravity_said(site)}, more than {GRAVITY_REFUSED / MILLIGAL:.0f}: every scale factor of the "
            "accelerometers would be wrong with it; correct gravity, latitude_deg or height_m in [site], or write "
            "gravity_confirmed = true"
        )
