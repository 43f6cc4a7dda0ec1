"""A group of parameters: each accelerometer by the product of the forces along body X and Y."""

import numpy as np

from tumble.sensors.model import Block
from tumble.sensors.parameters import FUNCTIONS, PAIRS, PRODUCTS, ParameterGroup
from tumble.units import Array


def by_product(block: Block) -> Array:
    """Derivatives (n, 15, n) of the coefficients of a reading by the parameters."""
    out = np.zeros((block.size, FUNCTIONS, block.size))
    each = np.arange(block.size)  # names are in the order of the sensors, rows in that of the channels
    out[block.channels, PRODUCTS.start + PAIRS.index((0, 1)), each] = 1.0
    return out


PRODUCT = ParameterGroup(
    name="accel.product",
    kind="accel",
    unit="s^2/m",
    words="accelerometers by the product of the forces along X and Y",
    suffixes=lambda block: block.sensors,
    limit=1e-2,  # how far from zero a value may reasonably be
    usual=dict.fromkeys(("navigation", "tactical", "mems", "consumer"), 5e-5),  # standard deviation over instruments
    regressors=by_product,
)
