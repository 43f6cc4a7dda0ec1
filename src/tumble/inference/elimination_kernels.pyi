from tumble.units import Array, IntArray

LANES: int

def eliminate_rests(
    rest: Array,
    turn: Array,
    link: IntArray,
    factor: Array,
    rounding: float,
    work: Array,
    carried: Array,
    kept: Array,
    length: Array,
    parts: Array,
) -> int: ...
def put_back(factor: Array, inverse: Array, by_next: Array) -> None: ...
def follow(by_next: Array, values: Array) -> None: ...
def carry_back(inverse: Array, by_next: Array, own: Array, with_next: Array) -> None: ...
def whiten(
    noise: Array,
    directions: Array,
    component: IntArray,
    variance: Array,
    weight: Array,
    work: Array,
    factors: Array,
) -> bool: ...
def reduced_rows(rows: Array, first: IntArray, by: Array, shared: Array, residual: Array, reduced: Array) -> None: ...
def residual_covariances(
    rows: Array,
    first: IntArray,
    own: Array,
    with_next: Array,
    along: Array,
    covariance: Array,
    work: Array,
) -> None: ...
def state_forms(
    by: Array,
    own: Array,
    with_next: Array,
    along: Array,
    shared: Array,
    rho: Array,
    step: Array,
    lapse: Array,
    work: Array,
    forms: Array,
) -> None: ...
def fold_sizes(
    information: Array, right: Array, size: Array, factor: Array, value: Array, log_likelihood: Array
) -> None: ...
def mean_covariance(factor: Array, size: Array, weight: Array, work: Array, covariance: Array) -> None: ...
