"""Causes and remedies of faulty recordings and of poor estimates.

Recordings are judged before anything is estimated, by `channels` and `carried_vertical` (with `turn_likelihood`).
Estimates are judged by `verdict`, from the findings of `undetermined` (with `observability`), of `misfit` (with the
possible causes of `causes` and `lost_samples`, fitted by `projection`) and of `unusual_sizes`.
"""
