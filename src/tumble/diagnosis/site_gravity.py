"""Gravity of a site against normal gravity of its latitude and height."""

from __future__ import annotations

from collections.abc import Iterator

from tumble.earth import normal_gravity
from tumble.recording.session import Site
from tumble.units import two_digits

MILLIGAL = 1e-5  # m/s²
GRAVITY_DOUBTED = 300.0 * MILLIGAL
GRAVITY_REFUSED = 1100.0 * MILLIGAL
"""Anomalies of gravity on Earth reach 300 mGal on land in a few places; nowhere 1,000. The limit lets the value through
that imu_tk takes for its recording, 1,091 mGal more than normal gravity, which published results rest on."""


def gravity_difference(site: Site) -> float | None:
    """Gravity of a site less normal gravity, m/s²; None where the latitude is not known."""
    return None if site.latitude is None else site.gravity - normal_gravity(site.latitude, site.height)


def against_normal(site: Site) -> str | None:
    """How far gravity is from normal gravity; where it is that to the last digit and no better known than a milligal,
    which any measurement is, none was measured: then the uncertainty it has. None where the latitude is not known."""
    difference = gravity_difference(site)
    if difference is None:
        return None
    if difference == 0.0 and site.gravity_u > MILLIGAL:
        return f"normal gravity assumed, u {two_digits(1e6 * site.gravity_u / site.gravity)} ppm"
    return f"{difference / MILLIGAL:+z.0f} mGal from normal gravity"


def gravity_said(site: Site) -> str:
    """Gravity, and where the latitude is known what it is against normal gravity."""
    against = against_normal(site)
    return f"gravity {site.gravity:.6f} m/s^2" + ("" if against is None else f", {against}")


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
