"""Initial values of a magnetometer in the joint estimate of a session, and its result.

Steel and motors disturb some of the readings m, so that the first fit is robust (`_agreeing`). Gyros carry the
attitudes L along a chain of stations, known up to a common heading. Then T = S⁻¹, c = T b and the field h are linear,

    L_i (T m_i − c) − h = 0

five stations determine them up to a factor, and most of the readings agree with the true ones. Without such a chain,
or if a turn spoils it, the readings lie on an ellipsoid about the hard iron b, (m − b)ᵀ H (m − b) = 1, whose
coefficients are the last right singular vector of the matrix of its monomials. With H⁻¹ = A Aᵀ the field is along Q q,
q = A⁻¹ (m − b), with an orthogonal Q. At one place the angle between the vertical u and the field is the same in every
attitude,

    uᵢᵀ Q qᵢ = −sin I for all stations i,

which is linear in Q and sin I, and determines them up to their sign; Q is the orthogonal matrix nearest to the
solution. The sign of Q or T is that with which the field points down in the northern hemisphere and up in the southern;
near the equator, or at an unknown latitude, it is that of a rotation. The attitudes of each chain are then turned about
the vertical so that the field is north.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tumble.inference.estimate import DETERMINED, Fit
from tumble.inference.fits import MAGNETOMETER, chi_squares, left_out, outlier_weights, sigmas
from tumble.inference.linearisation import Linearisation, linearise
from tumble.inference.magnetometer import DIP, Magnetometer
from tumble.inference.maximum import Maximum, reintegrated_turns, take_step
from tumble.inference.normal_equations import solve
from tumble.rotation import UP, rotation_matrix, signed_permutations, unit_vector
from tumble.sensors.model import Block, SensorModel
from tumble.units import DEGREE, Array, BoolArray, IntArray

FLAT = 1e-3  # second smallest singular value over the largest, below which a fit is not unique
REDUNDANCY = 1.5  # equations of the fewest readings that must agree, relative to unknowns
WIDENED = 9.0  # variance of Gaussian errors over that of the half which agrees best, after its fit
SUBSETS, CONCENTRATIONS, REFITS = 400, 4, 12  # of a robust fit; of 12 rests with 4 near steel, 28 subsets have none
AGREEING = 3.0  # standard deviations within which readings agree
MOST_DISTURBED = 1.0 / 3.0  # share of disturbed readings that are left out
NEAR = 1e-3  # standard deviation, relative to the field, that is assumed at least
SCATTER_LIMIT = 2e-2  # scatter, relative to the field, above which the magnetometer is refused: the field varies
NEAR_EQUATOR = 20.0 * DEGREE  # latitude below which the field may point up or down
FIRST_STEPS = 4  # steps of the other sensors, before the magnetometer is fitted to their attitudes


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MagnetometerEstimate:
    """Estimate of a magnetometer.

    Parameters
    ----------
    names, values : (12,)
        Parameters of its block: biases in its unit, scale-factor errors, and axis angles, rad.
    covariance : (12, 12)
        Covariance of the values given the parameters of the other sensors.
    by_parameters : (12, m)
        Derivatives of the values by these parameters, through the attitudes.
    model
        Sensors with these values, in the frame of the accelerometers.
    magnetometer
        Nominal axes, and modulus of the field.
    dip
        Dip of the field, rad.
    fit
        Chi-square of the readings.
    left_out, sigmas, off : (K,)
        For the readings at rests, then at nodes: True for outliers left out, distance from the fit in sigmas, and error
        of the modulus, in its unit.
    time : (K,)
        Time of the readings, s.
    refused
        Reason why the values cannot be used, or "".
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
    by_parameters: Array
    model: SensorModel
    magnetometer: Magnetometer
    dip: float
    fit: Fit
    left_out: BoolArray
    sigmas: Array
    off: Array
    time: Array
    refused: str = ""


def with_magnetometer(start: Linearisation) -> tuple[Linearisation, str]:
    """Add the magnetometer of a session to its first linearisation.

    Returns the linearisation and "", or the same linearisation and the reason why its readings cannot be used."""
    problem, integrated = start.problem, start.integrated
    if problem.magnetic is None:
        return start, ""
    readings, _, _, station = problem.magnetic
    linearisation, point = start, start.point
    for _ in range(FIRST_STEPS):
        point, _ = take_step(solve(linearisation))
        integrated = reintegrated_turns(problem, point, integrated)
        linearisation = linearise(problem, point, integrated)
    attitudes = point.attitudes[station]
    fit = by_attitudes(readings, attitudes, problem.chain[station])
    if fit is None or np.mean(~fit[2]) > MOST_DISTURBED:  # perhaps by a spoilt turn, which the joint fit finds
        fit = by_ellipsoid(readings, attitudes[:, 1]) or fit
    if fit is None:
        return start, (
            f"its {len(readings)} readings lie on no one ellipsoid: the attitudes are too few or too much "
            "alike, or a channel does not follow the field; record away from steel in more attitudes"
        )
    in_unit_field, upward, kept = fit  # sensors, vertical part of a field of modulus 1, and readings that agree

    # modulus, sign and dip of the field
    site = problem.observations.site
    field = site.field or float(np.cbrt(abs(np.linalg.det(in_unit_field.matrix))))
    latitude, S = site.latitude or 0.0, in_unit_field.matrix / field
    if upward * latitude > 0.0 if abs(latitude) > NEAR_EQUATOR else np.linalg.det(S) < 0.0:
        S, upward = -S, -upward
    magnetometer = Magnetometer(block=block_near(S), field=field, dip=float(-np.arcsin(upward)))
    model = SensorModel(matrix=S, bias=in_unit_field.bias)

    # heading of each chain, with the field to the north
    direction = (attitudes[kept] @ unit_vector(model.apply(readings[kept]))[:, :, None])[:, :, 0]
    chain, chains = problem.chain, problem.chain[-1] + 1
    north, east = (np.bincount(chain[station[kept]], direction[:, axis], chains) for axis in (0, 2))
    turned = rotation_matrix(np.arctan2(east, north)[chain][:, None] * UP) @ point.attitudes

    # the unknowns of the magnetometer come first among those of the session
    unknowns = np.concatenate([magnetometer.block.parameters(model), np.zeros(len(magnetometer.u) - DIP)])
    local = np.concatenate([np.broadcast_to(unknowns, (len(point.local), len(unknowns))), point.local], axis=1)
    u = np.concatenate([magnetometer.u, problem.local_u])
    problem = replace(problem, magnetometer=magnetometer, local_u=u, usual_local_u=u)
    linearisation = linearise(problem, replace(point, attitudes=turned, local=local), integrated)
    return replace(linearisation, noise=linearisation.noise.weighted(outlier_weights({"mag": ~kept}))), ""


def by_attitudes(readings: Array, attitudes: Array, chain: IntArray) -> tuple[SensorModel, float, BoolArray] | None:
    """Fit a magnetometer to readings (K, 3) in attitudes (K, 3, 3) that gyros carry along a chain (K,).

    Returns the sensors in a field of modulus 1, the vertical part of that field, and True for the readings (K,) that
    agree; None without a unique fit, or if most readings are in other chains."""
    mean, size = readings.mean(axis=0), readings.std()
    longest = chain == np.argmax(np.bincount(chain))
    if 2 * longest.sum() <= len(chain) or not size > 0.0:  # or not finite
        return None
    m, by_field = (readings - mean) / size, np.broadcast_to(-np.eye(3), attitudes.shape)
    by_matrix = np.einsum("kap,kq->kapq", attitudes, m).reshape(-1, 3, 9)
    rows = np.concatenate([by_matrix, -attitudes, by_field], axis=2)
    agreeing = _agreeing(rows[longest], np.eye(15)[:, 12:], 0.5)
    if agreeing is None:
        return None
    x, of_chain, limit = agreeing
    T, h = x[:9].reshape(3, 3), np.linalg.norm(x[12:])
    kept = (np.linalg.norm(m @ T.T - x[9:12], axis=1) / h - 1.0) ** 2 <= limit
    kept[longest] = of_chain
    unit = np.linalg.inv(T)
    return SensorModel(matrix=size * h * unit, bias=mean + size * unit @ x[9:12]), float(x[13] / h), kept


def _agreeing(rows: Array, modulus: Array, share: float) -> tuple[Array, BoolArray, float] | None:
    """Return the unit vector x that most readings agree with, rows (K, r, c) times x being zero but for errors.

    Errors are relative to |x @ modulus|. x is first that with the smallest sum of squares over more than a `share` of
    the readings (least trimmed squares), begun from random subsets that determine it; readings within AGREEING
    standard deviations are then added and others removed until they stay the same. Returns also True for these (K,),
    and the square of the largest error; None unless x is unique."""
    K, r, c = rows.shape
    fewest = -(-(c - 1) // r)
    least = max(int(share * K) + 1, int(np.ceil(REDUNDANCY * (c - 1) / r)))
    squares = (np.swapaxes(rows, 1, 2) @ rows).reshape(K, -1)

    def fit(member: Array) -> tuple[Array, Array, Array]:
        """Return eigenvalues (s, c), x (s, c) and squared errors (s, K) of fits to s subsets, 1 or 0 (s, K)."""
        value, vector = np.linalg.eigh((member @ squares).reshape(-1, c, c))
        x = vector[:, :, 0]
        error = ((rows @ x.T) ** 2).sum(axis=1).T
        return value, x, error / np.maximum(((x @ modulus) ** 2).sum(axis=1), 1e-300)[:, None]

    # least trimmed squares: each subset becomes that of the smallest errors
    kept = np.ones((1, K))
    if least < K:
        order = np.random.default_rng(K).random((SUBSETS, K)).argsort(axis=1)
        kept = np.where(order.argsort(axis=1) < fewest, 1.0, 0.0)
        for _ in range(CONCENTRATIONS):
            error = fit(kept)[2]
            kept = np.where(error <= np.partition(error, least - 1, axis=1)[:, least - 1 : least], 1.0, 0.0)
        kept = kept[[np.argmin((error * kept).sum(axis=1))]]

    # all readings that agree with the best of them
    for widened in (WIDENED, *[1.0] * REFITS):
        value, x, error = fit(kept)
        scale = float((error * kept).sum() / max(r * kept.sum() - c + 1, 1.0))
        limit = r * AGREEING**2 * max(widened * scale, NEAR**2)
        before, kept = kept, np.where(error <= limit, 1.0, 0.0)
        if np.array_equal(kept, before) or kept.sum() < least:
            break
    if value[0, 1] < FLAT**2 * value[0, -1]:
        return None
    return x[0], before[0] > 0.0, limit


def by_ellipsoid(readings: Array, vertical: Array) -> tuple[SensorModel, float, BoolArray] | None:
    """Fit an algebraic ellipsoid to readings (K, 3), directed by the vertical (K, 3) in the body at each.

    Returns what `by_attitudes` does; None without a unique ellipsoid."""
    mean, size = readings.mean(axis=0), readings.std(axis=0)
    if not np.all(size > 0.0):  # not finite, or constant
        return None
    x, y, z = ((readings - mean) / size).T
    rows = np.stack(
        [x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, 2 * x, 2 * y, 2 * z, np.ones_like(x)], axis=1
    )
    # 2 (a + b + c) is twice the level of the quadric about its centre, by which the radius is off, for a sphere
    agreeing = _agreeing(rows[:, None], np.where(np.arange(10) < 3, 2.0, 0.0)[:, None], 0.8)
    if agreeing is None:
        return None
    x, kept, _ = agreeing
    a, b, c, d, e, f, *linear, one = x * np.sign(x[:3].sum())
    H = np.array([[a, d, e], [d, b, f], [e, f, c]])
    if np.linalg.eigvalsh(H)[0] <= 0.0:
        return None
    centre = -np.linalg.solve(H, linear)
    if (level := float(centre @ H @ centre) - one) <= 0.0:
        return None
    lower = np.linalg.cholesky(np.linalg.inv(H / level))
    sphere = SensorModel(matrix=size[:, None] * lower, bias=mean + size * centre)
    q, u = unit_vector(sphere.apply(readings[kept])), vertical[kept]
    rows = np.column_stack([np.einsum("ki,kj->kij", u, q).reshape(-1, 9), -np.ones(len(q))])
    left, _, right = np.linalg.svd(np.linalg.svd(rows)[2][-1, :9].reshape(3, 3))
    Q = left @ right
    return SensorModel(matrix=sphere.matrix @ Q.T, bias=sphere.bias), float((u * (q @ Q.T)).sum(axis=1).mean()), kept


def block_near(matrix: Array) -> Block:
    """Return the magnetometer block with the nominal axes nearest to a sensitivity matrix (3, 3)."""
    axes = signed_permutations()
    return Block(kind="mag", axes=axes[np.argmax((axes * matrix).sum(axis=(1, 2)))])


def magnetometer_estimate(fitted: Maximum, step: Array) -> MagnetometerEstimate | None:
    """Return the estimate of the magnetometer of a session; None without one.

    Parameters
    ----------
    fitted
        The maximum of ℓ(φ).
    step : (1 + m,)
        Posterior step of gravity and the parameters from the last linearisation.
    """
    problem, solution, links = fitted.problem, fitted.solution, fitted.problem.observations.links
    magnetometer = problem.magnetometer
    if magnetometer is None or problem.magnetic is None:
        return None
    readings, _, _, station = problem.magnetic
    covariance, across = solution.session_covariance[1:, 1:], solution.roots[0, :DIP] @ solution.session_root[1:].T
    u = np.sqrt(covariance.diagonal())
    by_parameters = np.linalg.solve(covariance / np.outer(u, u), (across / u).T).T / u
    unknowns = fitted.point.local[0, : len(magnetometer.u)].copy()
    unknowns[:DIP] += by_parameters @ (step - solution.session_step)[1:]
    model, outliers = magnetometer.model(unknowns), left_out(fitted.linearisation.noise.weights)["mag"]
    rests = problem.observations.rests
    time = 0.5 * (rests.start + rests.stop) if links is None else links.time[station]
    marginal, fit = solution.session_covariances[0, :DIP, :DIP], chi_squares(solution)[MAGNETOMETER]
    undetermined = np.sqrt(marginal.diagonal()) > magnetometer.u[:DIP] / DETERMINED
    names = np.array(magnetometer.block.names)[undetermined].tolist()
    refused = f"nothing determines {', '.join(names)}: take more attitudes" if names else ""
    if fit.scatter > SCATTER_LIMIT * magnetometer.field:
        refused = (
            f"the readings scatter by {fit.scatter:.3g}, more than {100 * SCATTER_LIMIT:g} % of the field: the field "
            "is not the same in all of them; record away from steel"
        )
    agreeing = by_attitudes(readings, fitted.point.attitudes[station], problem.chain[station])
    disturbed = max(outliers.sum(), 0 if agreeing is None else np.sum(~agreeing[2]))
    if disturbed > MOST_DISTURBED * len(outliers):
        refused = (
            f"the field is not the same in {disturbed} or more of its {len(outliers)} readings, too many to tell which "
            "are disturbed; record away from steel, with motors off"
        )
    return MagnetometerEstimate(
        names=magnetometer.block.names,
        values=unknowns[:DIP],
        covariance=marginal - by_parameters @ across.T,
        by_parameters=by_parameters,
        model=model,
        magnetometer=magnetometer,
        dip=magnetometer.dip + float(unknowns[DIP]),
        fit=fit,
        left_out=outliers,
        sigmas=sigmas(solution)["mag"],
        off=np.linalg.norm(model.apply(readings), axis=1) - magnetometer.field,
        time=time,
        refused=refused,
    )
