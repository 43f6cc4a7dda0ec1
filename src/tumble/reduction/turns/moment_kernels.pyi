from tumble.units import Array, IntArray

LINEAR: int
GROUP: int
HEAD: int
BLOCK: int

Terms = tuple[Array, Array]
"""Matrix and offset (3, 4) of y, and a row (n, 9) for each sensor with nonlinear terms: axis, coefficients of u², u³
and |u|, and effect on the vector."""
Model = tuple[Terms, Terms, Array, float]
"""Gyros, accelerometers, what the body's rate reads of its force (3, 3), delay (s)."""
Sums = tuple[Array, Array, Array, Array, Array, Array, Array]
"""Attitude (K, 4), scalar first, V and P (K, 3), Σ C_m ⊗ regressors and as the tenth row Σ regressors (K, 10, R),
Σ (C_m × (V + ½ΔV)) ⊗ those before f f (K, 9, Q), Σ C_m [ω×] dt ⊗ f (K, 9, BLOCK), Σ Δt² |f − f'|² (K,). R and Q are
multiples of BLOCK. Regressors are 1, ω, f (LINEAR), those of the gyros' own axes, f f, ω ω, and of the accelerometers'
own axes, all times dt."""

def integrate_pieces(
    samples: tuple[Array, Array, Array],
    pieces: tuple[IntArray, IntArray, IntArray],
    model: Model,
    own_axes: tuple[Array, Array],
    sums: Sums,
) -> None: ...
