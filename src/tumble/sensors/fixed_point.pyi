from tumble.units import Array, IntArray

INVERSE: int
AXIS: int
REFERENCE: int
CHANGES: int
LEVER: int
SENSITIVITY: int
ACROSS: int
ALONG: int
WIDTH: int
TOO_WARM: int
TOO_FAST: int
TOO_MUCH: int

def fixed_point(
    readings: Array,
    celsius: Array,
    thermometers: IntArray,
    other: Array,
    sheet: Array,
    steps: int,
    *,
    of_force: bool,
    feels: bool,
) -> Array: ...
def advance(
    given: tuple[Array, ...],
    sensors: tuple[Array, Array, IntArray, IntArray, int, int, bool],
    settings: Array,
    state: tuple[Array, ...],
    held: int,
    out: tuple[Array, ...],
    *,
    moved: bool,
    last: bool,
) -> tuple[int, int]: ...
