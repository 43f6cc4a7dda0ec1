"""The restricted likelihood by dense matrices: nothing is eliminated from rest to rest, and no state of a bias is an
unknown.

Attitudes have no prior. With K an orthonormal basis of what is orthogonal to their columns A, the contrasts Kᵀy do not
know them, and with all the noise of the rows in V, biases that are a process included, X the columns of gravity and the
parameters, and P₀ the precision of their priors,

    −2 ℓ = (y − X x̂)ᵀ K (KᵀVK)⁻¹ Kᵀ (y − X x̂) + x̂ᵀP₀x̂ + ln |KᵀVK| + ln |AᵀA| + ln |XᵀK(KᵀVK)⁻¹KᵀX + P₀| − ln |P₀|

with the score ½ (rᵀP D P r − tr P D) by everything that V or the priors depend on, D = ∂V.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.support.plain_rows import covariances, directions, plain_rows
from tumble.units import Array

TIMES = ("accel_time", "gyro_time")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Dense:
    """−2 ℓ, x (gravity and the parameters, after what each session has of its own) and its covariance, those with the
    biases of the session in place of the means of their processes, and the score: by ln σ of every component, by ln of
    the factor of every sensor, and by ln of the standard deviation of every prior. Of each of these ∂V P r, priors
    being rows as others are, and P, of which the average information ½ rᵀP∂V P ∂V P r is made."""

    deviance: float
    x: Array
    covariance: Array
    session_x: Array
    session_covariance: Array
    by_component: dict[str, float]
    by_sensor: Array
    by_prior: Array
    variates: dict[str, Array]
    variates_of_sensors: Array
    variates_of_priors: Array
    projector: Array


def dense(problem: Any, rows: Any, noise: Any, components: Any, priors: tuple[Array, Array]) -> Dense:
    """By the rows at a linearisation, the parts of their noise, the components of variance, and `priors`, standard
    deviations and expected values less those of the point, of x."""
    plain, bias, session = plain_rows(rows), rows.bias, problem.session_of_station
    N, K, n = len(plain.rest), len(plain.turn), problem.sensors
    r, t, q = plain.rest.shape[1], plain.turn.shape[1], len(problem.local_u)
    after = problem.bias_after
    p, S, M = plain.rest.shape[2] - 4 - q, len(problem.session_spans), N * r + K * t
    A, X, B, y = np.zeros((M, 3 * N)), np.zeros((M, S * q + p)), np.zeros((M, n, N)), np.zeros(M)
    base, D = np.zeros((M, M)), dict[tuple[str, int], Array]()
    names = ("accel", "gyro", "turn", "velocity", "apart", "jumps", "aliased", "aliased_apart")
    first = problem.before_turn
    blocks = [("rest", i, slice(i * r, i * r + r), i, 3, session[i]) for i in range(N)]
    blocks += [("turn", k, slice(N * r + k * t, N * r + k * t + t), first[k], 6, session[first[k]]) for k in range(K)]
    of_noise = dict(zip(("rest", "turn"), zip(covariances(noise), directions(noise), strict=True), strict=True))
    for kind, k, own, i, wide, s in blocks:
        row, (N_of_kind, (Z, of)) = getattr(plain, kind)[k], of_noise[kind]
        A[own, 3 * i : 3 * i + wide], y[own] = row[:, :wide], row[:, -1]
        X[own, S * q :], X[own, s * q : s * q + q] = row[:, wide : wide + p], row[:, wide + p : -1]
        if kind == "rest":
            B[own, :, i] = np.eye(r, n)
        else:
            B[own, :, i] += (1.0 - after) * bias[k]
            B[own, :, i + 1] += after * bias[k]
        base[own, own] = N_of_kind[k]
        for c, component in enumerate(of.tolist()):
            key = names[component], c if kind == "rest" else -1
            D.setdefault(key, np.zeros((M, M)))[own, own] += np.outer(Z[k][:, c], Z[k][:, c])

    # everything in units of the noise
    L = np.linalg.cholesky(base)
    A, X, y = (np.linalg.solve(L, each) for each in (A[:, A.any(axis=0)], X, y))  # headings that nothing shows
    B = np.linalg.solve(L, B.reshape(M, -1)).reshape(M, n, N)
    Q, R = np.linalg.qr(A, mode="complete")
    contrasts = Q[:, A.shape[1] :]
    D = {key: contrasts.T @ np.linalg.solve(L, np.linalg.solve(L, each).T) @ contrasts for key, each in D.items()}
    X, y, B = contrasts.T @ X, contrasts.T @ y, np.einsum("mc,msi->csi", contrasts, B)
    unlike = components.unlike if components.unlike.size else np.ones(n)
    V = np.eye(len(y))
    for (name, sensor), each in D.items():
        each *= getattr(components, name) ** 2 * (unlike[sensor] ** 2 if sensor >= 0 else 1.0)
        V += each
    rests, accelerometers = problem.observations.rests, problem.instrument.accel.size
    middle = 0.5 * (rests.start + rests.stop)
    together = (session[:, None] == session) & (rests.file[:, None] == rests.file)
    apart = np.where(together, np.abs(middle[:, None] - middle), np.inf)
    kinds = np.repeat(["accel", "gyro"], [accelerometers, n - accelerometers])
    states, by_time = [], []
    for s, kind in enumerate(kinds.tolist()):
        sigma, tau = getattr(components, f"{kind}_in_run") * unlike[s], getattr(components, f"{kind}_time")
        states.append(sigma**2 * np.exp(-apart / tau))
        by_time.append(states[-1] * np.where(together, apart, 0.0) / tau)
        V += B[:, s] @ states[-1] @ B[:, s].T

    # least squares
    u, expected = priors
    known = u > 0.0
    precision = np.where(known, 1.0 / np.where(known, u, 1.0) ** 2, 0.0)
    half = np.linalg.cholesky(V)
    WX, Wy = np.linalg.solve(half, X[:, known]), np.linalg.solve(half, y)
    scale = 1.0 / np.linalg.norm(np.vstack([WX, np.diag(precision[known] ** 0.5)]), axis=0)
    orthogonal, triangle = np.linalg.qr(np.vstack([WX, np.diag(precision[known] ** 0.5)]) * scale)
    right = np.append(Wy, precision[known] ** 0.5 * expected[known])
    x, covariance = np.zeros(len(u)), np.zeros((len(u), len(u)))
    root = scale[:, None] * np.linalg.inv(triangle)
    x[known] = root @ (orthogonal.T @ right)
    covariance[np.ix_(known, known)] = root @ root.T
    left = right - orthogonal @ (orthogonal.T @ right)
    pivots = np.log(np.abs(np.diag(triangle)) / scale).sum() + np.log(np.abs(np.diag(R))).sum()
    determinants = np.log(np.diag(half)).sum() + np.log(np.diag(L)).sum()
    sizes = np.log(u[S * q + 1 + problem.instrument.linear_count :]).sum() + np.log(u[: S * q]).sum()

    # score
    solved = np.linalg.inv(half)
    projected = solved @ X[:, known] @ root
    P = solved.T @ (np.eye(len(y)) - projected @ projected.T) @ solved
    Py = solved.T @ left[: len(y)]

    def score(by: Array) -> float:
        return float(Py @ by @ Py - np.sum(P * by))

    of_states = np.array([score(B[:, s] @ C @ B[:, s].T) for s, C in enumerate(states)])
    of_times = np.array([0.5 * score(B[:, s] @ C @ B[:, s].T) for s, C in enumerate(by_time)])
    by_component = {name: sum(score(each) for (of, _), each in D.items() if of == name) for name in names}
    for kind in ("accel", "gyro"):
        by_component[f"{kind}_in_run"] = float(of_states[kinds == kind].sum())
        by_component[f"{kind}_time"] = float(of_times[kinds == kind].sum())
    by_sensor = of_states + np.array([sum(score(D[key]) for key in D if key[1] == s) for s in range(n)])
    by_prior = np.where(known, ((x - expected) ** 2 + np.diag(covariance)) * precision - 1.0, 0.0)

    # average information, with the priors as rows
    c, places = len(y), np.flatnonzero(known)
    every = np.zeros((c + len(places), c + len(places)))
    every[:c, :c], every[range(c, len(every)), range(c, len(every))] = V, 1.0 / precision[known]
    solved = np.linalg.inv(np.linalg.cholesky(every))
    of_x = solved @ np.vstack([X[:, known], np.eye(len(places))]) @ root
    projector = solved.T @ (np.eye(len(every)) - of_x @ of_x.T) @ solved

    def variate(by: Array) -> Array:
        return np.append(2.0 * by @ Py, np.zeros(len(places)))

    variates = {n: sum((variate(each) for (of, _), each in D.items() if of == n), variate(0.0 * V)) for n in names}
    by_states = np.array([variate(B[:, s] @ C @ B[:, s].T) for s, C in enumerate(states)])
    for kind in ("accel", "gyro"):
        variates[f"{kind}_in_run"] = by_states[kinds == kind].sum(axis=0)
        slopes = [variate(0.5 * B[:, s] @ C @ B[:, s].T) for s, C in enumerate(by_time) if kinds[s] == kind]
        variates[f"{kind}_time"] = sum(slopes, variate(0.0 * V))
    at_rest = [sum((variate(D[key]) for key in D if key[1] == s), variate(0.0 * V)) for s in range(n)]
    variates_of_priors = np.zeros((len(u), len(every)))
    variates_of_priors[places, c + np.arange(len(places))] = 2.0 * (expected - x)[places]

    # biases of the session: beside those of the processes the mean of what they wander by
    session_x, session_covariance = x.copy(), covariance.copy()
    if S == 1:
        G = np.array([C.mean(axis=0) @ B[:, s].T for s, C in enumerate(states)])
        b, cross = q + 1 + problem.biases, -covariance @ (X.T @ np.linalg.solve(V, G.T))
        session_x[b] += G @ Py
        session_covariance[:, b] += cross
        session_covariance[b] += cross.T
        session_covariance[np.ix_(b, b)] += np.diag([C.mean() for C in states]) - G @ P @ G.T
    return Dense(
        deviance=2.0 * float(pivots + determinants + sizes) + float(left @ left),
        x=x,
        covariance=covariance,
        session_x=session_x,
        session_covariance=session_covariance,
        by_component=by_component,
        by_sensor=by_sensor,
        by_prior=by_prior,
        variates=variates,
        variates_of_sensors=by_states + np.array(at_rest),
        variates_of_priors=variates_of_priors,
        projector=projector,
    )
