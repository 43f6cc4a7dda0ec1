# cython: language_level=3, infer_types=True, boundscheck=False, wraparound=False, initializedcheck=False, cdivision=True
"""Compiled loops of the correction of readings, sample by sample: the model of a block of sensors solved for the vector
that it measures, the effect of lever arms removed, and both for a stream.

Sums are evaluated in the order in which they are written.
"""

import numpy as np

from libc.math cimport exp
from libc.stdint cimport int64_t

from tumble.processors cimport for_each_processor

cpdef enum:
    _BIAS = 0
    _RATE = 1
    _FORCE = 4
    _PRODUCTS = 7
    _OWN_SIZE = 13
    _OWN_CUBE = 14
    INVERSE = 15
    AXIS = 18
    REFERENCE = 21
    CHANGES = 22
    LEVER = 28
    SENSITIVITY = 31
    ACROSS = 34
    ALONG = 37
    WIDTH = 38
    TOO_WARM = 1
    TOO_FAST = 2
    TOO_MUCH = 4

# A sheet (n, WIDTH) has a row for each sensor of a block. Its columns are the coefficients K of the functions β, those
# of the measured vector itself being zero, with the bias b at _BIAS; the column of S⁻¹, the left inverse of the
# sensitivity matrix (3); the nominal axis (3); the reference temperature, °C; the changes of b per K, K² and K³ and the
# relative changes of the gain s (6); and of an accelerometer the lever arm r (3), m, its sensitivity k (3), r × k (3)
# and r · k.


def fixed_point(
    const double[:, :] readings, const double[:, :] celsius, const int64_t[:] thermometers, const double[:, :] other,
    const double[:, :] sheet, Py_ssize_t steps, *, bint of_force, bint feels,
):
    """Return the vectors x (N, 3) that a block measures, by `steps` iterations x ← S⁻¹ ((ŷ − b − K β) / s) from zero.

    The sensors of the `sheet` (n, WIDTH) have the readings ŷ (N, n), SI. `celsius` (N, T): temperatures, °C;
    `thermometers` (n,): the column of each sensor in these. `of_force`: whether x is the specific force. `other`
    (N, 3): the rate if it is, else the specific force; used if the sensors respond to it (`feels`)."""
    out = np.empty((readings.shape[0], 3))
    cdef double[:, :] known = np.empty((2, sheet.shape[0])), solved = out
    with nogil:
        _solve(readings, celsius, thermometers, other, sheet, steps, of_force, feels, known, solved)
    return out


cdef for_each_processor _solve(
    const double[:, :] readings, const double[:, :] celsius, const int64_t[:] thermometers, const double[:, :] other,
    const double[:, :] sheet, Py_ssize_t steps, bint of_force, bint feels, double[:, :] known, double[:, :] out,
) noexcept nogil:
    """Write the result of `fixed_point` into `out`. `known` (2, n), work space: of each sensor the reading less all
    terms that do not depend on x, and the inverse gain 1/s."""
    cdef Py_ssize_t p
    cdef double x, y, z, u, v, w, own, value, warmer, gain, b1, b2, b3, s1, s2, s3
    linear = _RATE if of_force else _FORCE
    for i in range(readings.shape[0]):
        x, y, z = 0.0, 0.0, 0.0
        if feels:
            x, y, z = other[i, 0], other[i, 1], other[i, 2]
        u, v, w = 0.0, 0.0, 0.0
        for p in range(sheet.shape[0]):
            value, gain = readings[i, p] - sheet[p, _BIAS], 1.0
            b1, b2, b3 = sheet[p, CHANGES], sheet[p, CHANGES + 1], sheet[p, CHANGES + 2]
            s1, s2, s3 = sheet[p, CHANGES + 3], sheet[p, CHANGES + 4], sheet[p, CHANGES + 5]
            if b1 != 0.0 or b2 != 0.0 or b3 != 0.0 or s1 != 0.0 or s2 != 0.0 or s3 != 0.0:
                warmer = celsius[i, thermometers[p]] - sheet[p, REFERENCE]
                value -= warmer * (b1 + warmer * (b2 + b3 * warmer))
                gain = 1.0 / (1.0 + warmer * (s1 + warmer * (s2 + s3 * warmer)))
            if feels:
                value = value - sheet[p, linear] * x - sheet[p, linear + 1] * y - sheet[p, linear + 2] * z
                if not of_force:
                    value = value - _products(sheet, p, x, y, z)
            known[0, p], known[1, p] = value, gain
            value *= gain
            u, v = u + sheet[p, INVERSE] * value, v + sheet[p, INVERSE + 1] * value
            w = w + sheet[p, INVERSE + 2] * value
        x, y, z = u, v, w
        for _ in range(steps - 1):
            u, v, w = 0.0, 0.0, 0.0
            for p in range(sheet.shape[0]):
                own = sheet[p, AXIS] * x + sheet[p, AXIS + 1] * y + sheet[p, AXIS + 2] * z
                value = known[0, p] - own * (sheet[p, _OWN_CUBE] * own * own) - sheet[p, _OWN_SIZE] * abs(own)
                if of_force:
                    value -= _products(sheet, p, x, y, z)
                value *= known[1, p]
                u, v = u + sheet[p, INVERSE] * value, v + sheet[p, INVERSE + 1] * value
                w = w + sheet[p, INVERSE + 2] * value
            x, y, z = u, v, w
        out[i, 0], out[i, 1], out[i, 2] = x, y, z


cdef double _products(const double[:, :] sheet, Py_ssize_t p, double x, double y, double z) noexcept nogil:
    """Return the terms of a sensor in the products of the components of the specific force (x, y, z)."""
    by_x = sheet[p, _PRODUCTS] * x + sheet[p, _PRODUCTS + 1] * y + sheet[p, _PRODUCTS + 2] * z
    by_y = sheet[p, _PRODUCTS + 3] * y + sheet[p, _PRODUCTS + 4] * z
    return x * by_x + y * by_y + sheet[p, _PRODUCTS + 5] * z * z


# A stream ----------------------------------------------------------------------------------------------------


cdef void _differ(
    const double[:, :] values, const double[:] time, Py_ssize_t first, Py_ssize_t stop, double longest,
    double unknown, double[:, :] out,
) noexcept nogil:
    """Central differences of values (N, 3), per s, of samples `first` to `stop`, one-sided at both ends. Where the two
    samples are not more than 0 and at most `longest` s apart, they are `unknown`, which is NaN."""
    cdef double step
    cdef Py_ssize_t before, after, j
    for j in range(first, stop):
        before, after = max(j - 1, 0), min(j + 1, values.shape[0] - 1)
        step = time[after] - time[before]
        if not 0.0 < step <= longest:
            step = unknown
        for k in range(3):
            out[j, k] = (values[after, k] - values[before, k]) / step


cdef void _move(
    const double[:, :] readings, const double[:, :] rate, const double[:, :] acceleration, const double[:, :] sheet,
    Py_ssize_t first, Py_ssize_t stop, double[:, :] out,
) noexcept nogil:
    """Subtract the effect of lever arms from readings (N, n) of accelerometers, at rates ω and angular accelerations ω̇
    (N, 3): k · (ω̇ × r + ω × (ω × r)) = ω̇ · (r × k) + (ω · r) (ω · k) − ω² (r · k). Readings for which this is not
    finite are unchanged."""
    cdef double rx, ry, rz, size, kx, ky, kz, cx, cy, cz, x, y, z, turning, spinning, there
    cdef Py_ssize_t p, j
    for p in range(sheet.shape[0]):
        rx, ry, rz, size = sheet[p, LEVER], sheet[p, LEVER + 1], sheet[p, LEVER + 2], sheet[p, ALONG]
        kx, ky, kz = sheet[p, SENSITIVITY], sheet[p, SENSITIVITY + 1], sheet[p, SENSITIVITY + 2]
        cx, cy, cz = sheet[p, ACROSS], sheet[p, ACROSS + 1], sheet[p, ACROSS + 2]
        for j in range(first, stop):
            x, y, z = rate[j, 0], rate[j, 1], rate[j, 2]
            turning = acceleration[j, 0] * cx + acceleration[j, 1] * cy + acceleration[j, 2] * cz
            spinning = (x * rx + y * ry + z * rz) * (x * kx + y * ky + z * kz) - (x * x + y * y + z * z) * size
            there = readings[j, p] - turning - spinning
            out[j, p] = there if there - there == 0.0 else readings[j, p]


cdef Py_ssize_t _take(
    const double[:, :] accel, const double[:, :] gyro, const double[:] time, const double[:, :] thermometer,
    const double[:] settings, double[:, :] rows, double[:, :] warmth, double[:] clock, Py_ssize_t row,
) noexcept nogil:
    """Write new samples, without late ones, into the rows from `row` on; return the row after them.

    Follower p is that of thermometer p modulo their number, with its own lag (`tumble.reduction.rests.thermometer`), a
    negative lag being a lead. The time between samples is that of the stamps, or the usual interval if not positive."""
    cdef double now, before, behind, t, flag, interval, lag, step, kept
    cdef Py_ssize_t p, n, m
    interval = settings[0]
    n, m = accel.shape[1], gyro.shape[1]
    for i in range(accel.shape[0]):
        t = time[i] if time.shape[0] else interval * clock[1]
        if clock[0] - settings[3] < t <= clock[0]:
            clock[2] += 1.0
            continue
        step = t - clock[0]
        if not 0.0 < step < 1e300:
            step = interval
        clock[0], clock[1] = t if t == t else clock[0], clock[1] + 1.0
        flag = 0.0
        for p in range(warmth.shape[0]):
            before, behind, lag = warmth[p, 0], warmth[p, 1], warmth[p, 2]
            now = thermometer[i, p % thermometer.shape[1]] - settings[4]
            if now < settings[1] or now > settings[2]:
                flag = TOO_WARM
            if now != now:
                now = before
            if lag == 0.0 or behind != behind:
                behind = now
            else:
                kept = exp(-step / abs(lag))
                behind = now - kept * before - (now - before) / step * abs(lag) * (1.0 - kept) + kept * behind
            warmth[p, 0], warmth[p, 1] = now, behind
            rows[row, 2 + n + m + p] = behind if lag >= 0.0 else 2.0 * now - behind
        rows[row, 0], rows[row, 1] = t, flag
        for p in range(n):
            rows[row, 2 + p] = accel[i, p]
        for p in range(m):
            rows[row, 2 + n + p] = gyro[i, p]
        row += 1
    return row


def advance(given, sensors, settings, state, held, out, *, moved, last):
    """Correct one block of a stream; return the numbers of samples corrected, in `out`, and of rows held back.

    given : readings of accelerometers (N, n) and gyros (N, m), SI; stamps (N,), s, none for a regular clock;
        temperatures (N, T), °C or K.
    sensors : of both kinds the sheets, the thermometers, and the steps; whether gyros respond to the specific force.
    settings : 0, usual interval, s; 1 and 2, lowest and highest temperature, °C; 3, a sample up to this time, s, before
        the last one is dropped as late; 4, 0 °C in the unit of the temperatures; 5, longest step of a difference, s; 6
        and 7, squares of the largest rate and specific force; 8, NaN.
    state : rows (held + N, 2 + 2 n + m + F + 9): stamp, flag, readings, temperatures of F followers, rate, angular
        acceleration, specific force, and accelerometer readings without lever arms; (F, 3): temperature of thermometer
        and follower, °C, and lag, s; (3,): last stamp, and numbers of samples and of late ones; (2, n): work space.
    held : number of rows from before. If lever arms are to be removed (`moved`), the last row needs the next sample and
        is held back, unless this is the `last` block.
    out : stamp, flag and temperatures of the followers, in the unit given (M, 2 + F); specific force, rate (M, 3)."""
    (accel, gyro, time, thermometer), (rows, warmth, clock, known), (stamps, force, rate) = given, state, out
    accel_sheet, gyro_sheet, of_accel, of_gyro, accel_steps, gyro_steps, feels = sensors
    count = _advance(
        accel, gyro, time, thermometer, accel_sheet, gyro_sheet, of_accel, of_gyro, accel_steps, gyro_steps, feels,
        settings, rows, warmth, clock, known, held, stamps, force, rate, moved, last,
    )
    return count // 4, count % 4


cdef Py_ssize_t _advance(
    const double[:, :] accel, const double[:, :] gyro, const double[:] time, const double[:, :] thermometer,
    const double[:, :] accel_sheet, const double[:, :] gyro_sheet, const int64_t[:] of_accel,
    const int64_t[:] of_gyro, Py_ssize_t accel_steps, Py_ssize_t gyro_steps, bint feels, const double[:] settings,
    double[:, :] rows, double[:, :] warmth, double[:] clock, double[:, :] known, Py_ssize_t held, double[:, :] stamps,
    double[:, :] force, double[:, :] rate, bint moved, bint last,
):
    """Run `advance`; return four times the number of correct samples, plus the number of rows held back."""
    cdef Py_ssize_t n, m, heat, spin, total, first, stop, keep, j, p
    cdef double x, y, z
    cdef double[:, :] celsius, turning, change, rates, forces, there, plain
    n, m = accel.shape[1], gyro.shape[1]
    heat = 2 + n + m
    spin = heat + warmth.shape[0]
    with nogil:
        total = _take(accel, gyro, time, thermometer, settings, rows, warmth, clock, held)
        plain, turning, celsius = rows[:, 2 : 2 + n], rows[:, 2 + n : heat], rows[:, heat:spin]
        rates, change, forces = rows[:, spin : spin + 3], rows[:, spin + 3 : spin + 6], rows[:, spin + 6 : spin + 9]
        there = plain
        first, stop, keep = 0, total, 0
        if moved:
            there = rows[:, spin + 9 : spin + 9 + n]
            _solve(
                plain[held:total], celsius[held:total], of_accel, forces, accel_sheet, accel_steps, True, False, known,
                forces[held:total],
            )
            _solve(
                turning[held:total], celsius[held:total], of_gyro, forces[held:total], gyro_sheet, gyro_steps, False,
                feels, known, rates[held:total],
            )
            first, keep = max(held - 1, 0), min(total, 2)
            stop = total if last else max(total - 1, first)
            _differ(rates[:total], rows[:total, 0], first, stop, settings[5], settings[8], change)
            _move(plain, rates, change, accel_sheet, first, stop, there)
        _solve(
            there[first:stop], celsius[first:stop], of_accel, forces, accel_sheet, accel_steps, True, False, known,
            force[: stop - first],
        )
        if m:
            _solve(
                turning[first:stop], celsius[first:stop], of_gyro, force[: stop - first], gyro_sheet, gyro_steps, False,
                feels, known, rate[: stop - first],
            )
        for j in range(stop - first):
            stamps[j, 0], stamps[j, 1] = rows[first + j, 0], rows[first + j, 1]
            for p in range(spin - heat):
                stamps[j, 2 + p] = celsius[first + j, p] + settings[4]
            x, y, z = force[j, 0], force[j, 1], force[j, 2]
            if x * x + y * y + z * z > settings[7]:
                stamps[j, 1] += TOO_MUCH
            if m:
                x, y, z = rate[j, 0], rate[j, 1], rate[j, 2]
                if x * x + y * y + z * z > settings[6]:
                    stamps[j, 1] += TOO_FAST
        for j in range(keep):
            for p in range(rows.shape[1]):
                rows[j, p] = rows[total - keep + j, p]
    return 4 * (stop - first) + keep
