# cython: language_level=3, infer_types=True, boundscheck=False, wraparound=False, initializedcheck=False, cdivision=True
"""Compiled loops of `tumble.inference.elimination`, over rests, rows and columns.

Sums are evaluated in the order in which they are written. A compiler that may reorder them does so differently in each
compilation, and the rows of a campaign would differ in the last digit between processes.
"""

from libc.math cimport INFINITY, log, sqrt
from libc.stdint cimport int64_t

from tumble.processors cimport for_each_processor

cpdef enum:
    LANES = 48


def eliminate_rests(
    const double[:, :, :] rest, const double[:, :, :] turn, const int64_t[:] link, double[:, :, :] factor,
    double rounding, double[:, ::1] work, double[:, ::1] carried, double[::1, :] kept, double[::1] length,
    double[::1] parts,
):
    """Eliminate one rest after the other, and return the number of rows written to `kept`.

    rest, turn, link, factor : those of `tumble.inference.elimination.eliminate`.
    rounding : squared length of a column, relative to that before the elimination, below which it is rounding.
    work (d + r + t, 2d + p + 1 rounded up to LANES), parts (d + r + t,) : memory.
    carried (d, 2d + p + 1) : prior rows of the first rest.
    kept (rows, p + 1) : output, rows in the parameters alone.
    length (2d,) : memory, squared lengths of the columns before the elimination.
    """
    cdef Py_ssize_t count = 0
    with nogil:
        _eliminate_rests(rest, turn, link, factor, rounding, work, carried, kept, length, parts, &count)
    return count


cdef for_each_processor _eliminate_rests(
    const double[:, :, :] rest, const double[:, :, :] turn, const int64_t[:] link, double[:, :, :] factor,
    double rounding, double[:, ::1] work, double[:, ::1] carried, double[::1, :] kept, double[::1] length,
    double[::1] parts, Py_ssize_t* count,
) noexcept nogil:
    """Loop of `eliminate_rests`: gather the rows of rest i, reflect them, write `factor`, `carried` and `kept`."""
    d, columns = factor.shape[1], factor.shape[2]
    for i in range(rest.shape[0]):
        rows = _gather(work, carried, rest, i, turn, link[i])
        for c in range(2 * d):
            length[c] = length[c + d] if c < d else 0.0
            for row in range(d, rows):
                length[c] += work[row, c] * work[row, c]
        top = 0
        for c in range(d):
            seen = _reflect(work, parts, top, c, rows, rounding * length[c])
            for column in range(columns):
                factor[i, c, column] = work[top, column] if seen else 0.0
            top += seen
        carried[:, :] = 0.0
        for c in range(d, 2 * d):
            if _reflect(work, parts, top, c, rows, rounding * length[c]):
                for column in range(d, columns):
                    carried[c - d, column - d if column < 2 * d else column] = work[top, column]
                top += 1
        for column in range(2 * d, columns):
            for row in range(top, rows):
                kept[count[0] + row - top, column - 2 * d] = work[row, column]
        count[0] += rows - top


cdef Py_ssize_t _gather(
    double[:, ::1] work, double[:, ::1] carried, const double[:, :, :] rest, Py_ssize_t i, const double[:, :, :] turn,
    int64_t k,
) noexcept nogil:
    """Gather the rows in the unknowns of rest i: carried ones, those of the rest and of turn k. Return their number."""
    d, columns = carried.shape[0], carried.shape[1]
    rows = d
    for row in range(d):
        for column in range(columns):
            work[row, column] = carried[row, column]
    for row in range(rest.shape[1]):
        for column in range(d):
            work[rows, column], work[rows, d + column] = rest[i, row, column], 0.0
        for column in range(2 * d, columns):
            work[rows, column] = rest[i, row, column - d]
        rows += 1
    if k >= 0:
        for row in range(turn.shape[1]):
            for column in range(columns):
                work[rows, column] = turn[k, row, column]
            rows += 1
    return rows


cdef bint _reflect(
    double[:, ::1] work, double[::1] parts, Py_ssize_t top, Py_ssize_t column, Py_ssize_t rows, double least,
) noexcept nogil:
    """Reflect rows top … rows − 1 (Householder) so that the column is zero below row `top`; return whether it was done.

    Columns before `column` are zero; the others are reflected in groups of LANES. A column whose squared length is not
    above `least` is set to zero instead."""
    cdef double square, part
    cdef double[LANES] sums
    cdef Py_ssize_t lane, block
    square = 0.0
    for row in range(top, rows):
        parts[row] = work[row, column]
        square += parts[row] * parts[row]
        work[row, column] = 0.0
    if square <= least:
        return False
    head = parts[top]
    diagonal = -sqrt(square) if head > 0.0 else sqrt(square)
    parts[top] = head - diagonal
    scale = 1.0 / (diagonal * (diagonal - head))
    for group in range(column // LANES, work.shape[1] // LANES):
        block = group * LANES
        for lane in range(LANES):
            sums[lane] = 0.0
        for row in range(top, rows):
            part = parts[row]
            if part != 0.0:
                for lane in range(LANES):
                    sums[lane] += part * work[row, block + lane]
        for lane in range(LANES):
            sums[lane] *= scale
        for row in range(top, rows):
            part = parts[row]
            if part != 0.0:
                for lane in range(LANES):
                    work[row, block + lane] -= sums[lane] * part
    work[top, column] = diagonal
    return True


def put_back(const double[:, :, ::1] factor, double[:, :, ::1] inverse, double[:, :, ::1] by_next):
    """Write R⁻¹ into `inverse` and A = −R⁻¹ R_next into `by_next` (N, d, d), for `factor` [R | R_next | …]
    (N, d, 2d + w). Rows and columns of unknowns without information are zero."""
    with nogil:
        _put_back(factor, inverse, by_next)


cdef for_each_processor _put_back(
    const double[:, :, ::1] factor, double[:, :, ::1] inverse, double[:, :, ::1] by_next,
) noexcept nogil:
    cdef double part
    d = factor.shape[1]
    inverse[:, :, :] = 0.0
    by_next[:, :, :] = 0.0
    for i in range(factor.shape[0]):
        for a in range(d - 1, -1, -1):
            if factor[i, a, a] != 0.0:
                inverse[i, a, a] = 1.0 / factor[i, a, a]
                for b in range(a + 1, d):
                    for c in range(b, d):
                        inverse[i, a, c] -= factor[i, a, b] * inverse[i, b, c]
                for c in range(a + 1, d):
                    inverse[i, a, c] /= factor[i, a, a]
            for b in range(a, d):
                part = inverse[i, a, b]
                if part != 0.0:
                    for c in range(d):
                        by_next[i, a, c] -= part * factor[i, b, d + c]


def follow(const double[:, :, ::1] by_next, double[:, :, ::1] values):
    """Add `by_next[i]` @ `values[i + 1]` to `values[i]`, from the last rest to the first."""
    with nogil:
        _follow(by_next, values)


cdef for_each_processor _follow(const double[:, :, ::1] by_next, double[:, :, ::1] values) noexcept nogil:
    for i in range(by_next.shape[0] - 2, -1, -1):
        for a in range(by_next.shape[1]):
            for b in range(by_next.shape[1]):
                for q in range(values.shape[2]):
                    values[i, a, q] += by_next[i, a, b] * values[i + 1, b, q]


def carry_back(
    const double[:, :, ::1] inverse, const double[:, :, ::1] by_next, double[:, :, ::1] own,
    double[:, :, ::1] with_next,
):
    """Write the covariances (N, d, d) of the unknowns of each rest, `own` C_i = R⁻¹ R⁻ᵀ + A C_{i+1} Aᵀ, and those with
    the next rest, `with_next` A C_{i+1}, from the last to the first; `inverse` is R⁻¹ and `by_next` A."""
    with nogil:
        _carry_back(inverse, by_next, own, with_next)


cdef for_each_processor _carry_back(
    const double[:, :, ::1] inverse, const double[:, :, ::1] by_next, double[:, :, ::1] own,
    double[:, :, ::1] with_next,
) noexcept nogil:
    cdef double total
    N, d = by_next.shape[0], by_next.shape[1]
    with_next[:, :, :] = 0.0
    for i in range(N - 1, -1, -1):
        if i < N - 1:
            for a in range(d):
                for b in range(d):
                    for c in range(d):
                        with_next[i, a, c] += by_next[i, a, b] * own[i + 1, b, c]
        for a in range(d):
            for b in range(a + 1):
                total = 0.0
                for c in range(a, d):
                    total += inverse[i, a, c] * inverse[i, b, c]
                for c in range(d):
                    total += with_next[i, a, c] * by_next[i, b, c]
                own[i, a, b] = own[i, b, a] = total


def reduced_rows(
    const double[:, :, ::1] rows, const int64_t[:] first, const double[:, :, ::1] by, const double[::1] shared,
    double[:, ::1] residual, double[:, :, ::1] reduced,
):
    """Residuals of rows, and their coefficients E for the shared unknowns, directly and through the stations.

    rows : [A | ...] (K, t, u + w), with the u unknowns of one or two stations first.
    first (K,) : station of each block of rows, or the first of two.
    by (N, d, w) : `NormalEquations.sensitivity`, the unknowns of the stations as functions of the shared ones.
    shared (w,) : values of the shared unknowns, then −1.
    residual (K, t), reduced (K, t, w - 1) : output, residuals and E.
    """
    with nogil:
        _reduced_rows(rows, first, by, shared, residual, reduced)


cdef for_each_processor _reduced_rows(
    const double[:, :, ::1] rows, const int64_t[:] first, const double[:, :, ::1] by, const double[::1] shared,
    double[:, ::1] residual, double[:, :, ::1] reduced,
) noexcept nogil:
    cdef double part, last
    d, w = by.shape[1], by.shape[2]
    u = rows.shape[2] - w
    for k in range(rows.shape[0]):
        for a in range(rows.shape[1]):
            last = rows[k, a, u + w - 1]
            for c in range(w - 1):
                reduced[k, a, c] = rows[k, a, u + c]
            for b in range(u):
                part = rows[k, a, b]
                if part != 0.0:
                    station = first[k] + b // d
                    for c in range(w - 1):
                        reduced[k, a, c] += part * by[station, b % d, c]
                    last += part * by[station, b % d, w - 1]
            residual[k, a] = -_dot(&reduced[k, a, 0], &shared[0], w - 1) - last * shared[w - 1]


def residual_covariances(
    const double[:, :, ::1] rows, const int64_t[:] first, const double[:, :, ::1] own,
    const double[:, :, ::1] with_next, const double[:, :, ::1] along, double[:, :, ::1] covariance,
    double[:, ::1] work,
):
    """Covariances 1 - A S A' - (E U)(E U)' of the residuals of rows.

    rows, first : those of `reduced_rows`.
    own, with_next (N, d, d) : blocks of S, covariances of the unknowns of a station, and with those of the next.
    along (K, t, w - 1) : E U, with a root U of the covariance of the shared unknowns.
    work (t, u) : memory.
    """
    with nogil:
        _residual_covariances(rows, first, own, with_next, along, covariance, work)


cdef for_each_processor _residual_covariances(
    const double[:, :, ::1] rows, const int64_t[:] first, const double[:, :, ::1] own,
    const double[:, :, ::1] with_next, const double[:, :, ::1] along, double[:, :, ::1] covariance,
    double[:, ::1] work,
) noexcept nogil:
    """Loop of `residual_covariances`; `work` has A S."""
    cdef double part
    t, d, n, u = rows.shape[1], own.shape[1], along.shape[2], work.shape[1]
    for k in range(rows.shape[0]):
        i = first[k]
        work[:, :] = 0.0
        for a in range(t):
            for b in range(u):
                part = rows[k, a, b]
                if part != 0.0:
                    for c in range(d):
                        work[a, c] += part * (own[i, b, c] if b < d else with_next[i, c, b - d])
                    for c in range(u - d):
                        work[a, d + c] += part * (with_next[i, b, c] if b < d else own[i + 1, b - d, c])
            for b in range(a + 1):
                part = _dot(&work[a, 0], &rows[k, b, 0], u) + _dot(&along[k, a, 0], &along[k, b, 0], n)
                covariance[k, a, b] = covariance[k, b, a] = (1.0 if a == b else 0.0) - part


def state_forms(
    const double[:, :, ::1] by, const double[:, :, ::1] own, const double[:, :, ::1] with_next,
    const double[:, :, ::1] along, const double[::1] shared, const double[:, ::1] rho, const double[:, ::1] step,
    const double[:, ::1] lapse, double[:, :, ::1] work, double[:, ::1] forms,
):
    """Add the terms of the score of the states of a session, (25), over initial states and steps.

    by (N, d, w), shared (w,) : those of `reduced_rows`; the last s of the d unknowns are the states.
    own, with_next : those of `residual_covariances`.
    along (N, s, w - 1) : E U, with the rows E of `by` of the states and the root U of `residual_covariances`.
    rho, step, lapse (N, s) : correlation with the next state, standard deviation of the step to it, and Δt/τ, infinite
    where a new chain begins.
    work (2, s, 2) : memory.
    forms (3, s) : sums of squares, of 1 less their variances, and of derivatives by ln τ.
    """
    with nogil:
        _state_forms(by, own, with_next, along, shared, rho, step, lapse, work, forms)


cdef for_each_processor _state_forms(
    const double[:, :, ::1] by, const double[:, :, ::1] own, const double[:, :, ::1] with_next,
    const double[:, :, ::1] along, const double[::1] shared, const double[:, ::1] rho, const double[:, ::1] step,
    const double[:, ::1] lapse, double[:, :, ::1] work, double[:, ::1] forms,
) noexcept nogil:
    """Loop of `state_forms`; `work` has values and variances of the states of a station and of the one before."""
    cdef double part, value, variance, square, unknown, known, both, change, correlation, of_step
    d, w, s = by.shape[1], by.shape[2], rho.shape[1]
    for i in range(by.shape[0]):
        here, before = i % 2, (i + 1) % 2
        for k in range(s):
            j = d - s + k
            value = _dot(&by[i, j, 0], &shared[0], w)
            variance = own[i, j, j] + _dot(&along[i, k, 0], &along[i, k, 0], w - 1)
            work[here, k, 0], work[here, k, 1] = value, variance
            square, unknown = value * value, variance
            if i > 0:
                correlation, of_step = rho[i - 1, k], step[i - 1, k] * step[i - 1, k]
                both = with_next[i - 1, j, j] + _dot(&along[i - 1, k, 0], &along[i, k, 0], w - 1)
                known, change = work[before, k, 1], value - correlation * work[before, k, 0]
                square = change * change / of_step
                unknown = (variance - correlation * (2.0 * both - correlation * known)) / of_step
                if lapse[i - 1, k] < INFINITY:
                    part = change * work[before, k, 0] + both - correlation * known
                    part += correlation * (1.0 - square - unknown)
                    forms[2, k] += lapse[i - 1, k] * correlation * part / of_step
            forms[0, k] += square
            forms[1, k] += 1.0 - unknown


cdef double _dot(const double* x, const double* y, Py_ssize_t n) noexcept nogil:
    """Return the scalar product of n numbers by eight sums side by side."""
    cdef double[8] sums
    cdef double total = 0.0
    cdef Py_ssize_t lane, i, whole = n - n % 8
    for lane in range(8):
        sums[lane] = 0.0
    for i in range(0, whole, 8):
        for lane in range(8):
            sums[lane] += x[i + lane] * y[i + lane]
    for i in range(whole, n):
        total += x[i] * y[i]
    for lane in range(8):
        total += sums[lane]
    return total


cpdef bint whiten(
    const double[:, :, :] noise, const double[:, :, :] directions, const int64_t[:] component,
    const double[:] variance, const double[:, :] weight, double[:, ::1] work, double[:, :, ::1] factors,
) noexcept:
    """Write inverse Cholesky factors of noise + Σ v Z Zᵀ, their columns times the `weight` (N, n) of rows, into
    `factors`. Return whether all matrices are positive definite."""
    cdef double v, part, total, scale
    cdef Py_ssize_t a, b, c, k
    N, n, q = noise.shape[0], noise.shape[1], directions.shape[2]
    with nogil:
        for k in range(N):
            for a in range(n):
                for b in range(a + 1):
                    work[a, b] = noise[k, a, b]
            for c in range(q):
                v = variance[component[c]]
                if v > 0.0:
                    for a in range(n):
                        part = v * directions[k, a, c]
                        if part != 0.0:
                            for b in range(a + 1):
                                work[a, b] += part * directions[k, b, c]
            for a in range(n):
                for b in range(a + 1):
                    total = work[a, b]
                    for c in range(b):
                        total -= work[a, c] * work[b, c]
                    if b < a:
                        work[a, b] = total / work[b, b]
                    elif total > 0.0:
                        work[a, a] = sqrt(total)
                    else:
                        return False
            for a in range(n):
                scale = 1.0 / work[a, a]
                for c in range(a):
                    part = work[a, c] * scale
                    for b in range(c + 1):
                        factors[k, a, b] -= part * factors[k, c, b]
                factors[k, a, a] = scale
            for a in range(n):
                for b in range(a + 1):
                    factors[k, a, b] *= weight[k, b]
    return True


def fold_sizes(
    const double[:, :] information, const double[:] right, const double[:, :] size, double[:, :, ::1] factor,
    double[:, ::1] value, double[::1] log_likelihood,
):
    """Fold L priors c ~ N(0, S²) of g parameters into their information, with B = 1 + S Λ S.

    information, right : Λ (g, g) and h (g,).
    size (L, g) : standard deviations S.
    factor (L, g, g) : output, upper Cholesky factors R of B = Rᵀ R.
    value (L, g) : output, means S B⁻¹ S h of c.
    log_likelihood (L,) : output, ½ hᵀ S B⁻¹ S h − ½ ln |B|; NaN where B is not positive definite.
    """
    with nogil:
        _fold_sizes(information, right, size, factor, value, log_likelihood)


cdef for_each_processor _fold_sizes(
    const double[:, :] information, const double[:] right, const double[:, :] size, double[:, :, ::1] factor,
    double[:, ::1] value, double[::1] log_likelihood,
) noexcept nogil:
    cdef double part, total, determinant
    cdef double* row
    cdef double* other
    g = right.shape[0]
    for n in range(size.shape[0]):
        for a in range(g):
            row = &factor[n, a, 0]
            for b in range(a, g):
                row[b] = size[n, a] * information[a, b] * size[n, b]
            row[a] += 1.0
        total, determinant = 0.0, 0.0
        for k in range(g):
            row = &factor[n, k, 0]
            determinant += log(row[k])  # NaN if negative
            part = 1.0 / sqrt(row[k])
            for b in range(k, g):
                row[b] *= part
            for a in range(k + 1, g):
                part, other = row[a], &factor[n, a, 0]
                if part != 0.0:
                    for b in range(a, g):
                        other[b] -= part * row[b]
            part = size[n, k] * right[k]
            for a in range(k):
                part -= factor[n, a, k] * value[n, a]
            value[n, k] = part / row[k]
            total += value[n, k] * value[n, k]
        log_likelihood[n] = 0.5 * (total - determinant)
        for a in range(g - 1, -1, -1):
            part = value[n, a]
            for b in range(a + 1, g):
                part -= factor[n, a, b] * value[n, b]
            value[n, a] = part / factor[n, a, a]
        for a in range(g):
            value[n, a] *= size[n, a]


def mean_covariance(
    const double[:, :, ::1] factor, const double[:, :] size, const double[:] weight, double[:, ::1] work,
    double[:, ::1] covariance,
):
    """Write Σ w S B⁻¹ S (g, g) over the priors of `fold_sizes`, of weights w (L,); `work` (g, g) is memory."""
    with nogil:
        _mean_covariance(factor, size, weight, work, covariance)


cdef for_each_processor _mean_covariance(
    const double[:, :, ::1] factor, const double[:, :] size, const double[:] weight, double[:, ::1] work,
    double[:, ::1] covariance,
) noexcept nogil:
    cdef double part
    cdef double* row
    cdef const double* other
    g = covariance.shape[0]
    covariance[:, :] = 0.0
    for n in range(factor.shape[0]):
        for a in range(g - 1, -1, -1):  # R⁻¹
            row, part = &work[a, 0], 1.0 / factor[n, a, a]
            for c in range(a + 1, g):
                row[c] = 0.0
            row[a] = part
            for b in range(a + 1, g):
                part, other = factor[n, a, b] * row[a], &work[b, 0]
                if part != 0.0:
                    for c in range(b, g):
                        row[c] -= part * other[c]
        for a in range(g):
            for b in range(a, g):
                part = weight[n] * size[n, a] * size[n, b]
                covariance[a, b] += part * _dot(&work[a, b], &work[b, b], g - b)
    for a in range(g):
        for b in range(a):
            covariance[a, b] = covariance[b, a]
