"""tumble: calibration of strapdown inertial measurement units from recordings made on rough equipment.

Flow of data
    session.toml + log → Session, Log → rests and turns → Observations → method → Estimate → Calibration

Conventions, for every module
    units     SI and radians inside; a name that is not SI carries its unit (`latitude_deg`)
    frames    b  body X, Y, Z, fixed by the accelerometers (see `model`)
              n  geographic N (north), U (up), E (east), right-handed in the order N, U, E
              s  sensor: one coordinate per sensor
    vectors   `vec_a` is resolved in frame a; `mat_ab` takes coordinates in b to a
    model     reading = matrix @ true + bias; matrix n×3 = diag(1 + k) A(γ), Eq. (1) of the turntable paper
    gravity   an accelerometer at rest with its axis up reads +g; g is positive, m/s²
    samples   a sample is the mean over the interval that ends at its time stamp
    u         standard uncertainty (k = 1)

Symbols used as names where an equation is printed
    S   matrix of a block                u   direction of the vertical in the body, a unit vector
    C   rotation of a turn, body at its end → body at its start
    M   ∫ C ⊗ ω dt, B   ∫ C dt           sensitivities of a turn to gyro matrix and bias
    k   scale-factor error               γ   axis angle        Ω   Earth's rate
"""

from __future__ import annotations

from tumble.lazy import names_of

__version__ = "0.1.0"

_NAMES, __getattr__ = names_of(__name__, __file__)
__all__ = ["__version__", *_NAMES]


def __dir__() -> list[str]:
    """Return the public names, imported or not."""
    return __all__
