"""Upper confidence bound of the mean of values from 0 to 1 that holds at every moment of sampling."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ptd.arrays import Float64

BETS = np.array([0.1, 0.3, 0.5, 0.65, 0.8, 0.9, 0.96, 0.99, 1.0])
"""Bets as shares of the largest possible one, which loses all its capital at the first value of 1."""
LOG_SHARES = np.log([*8 * [0.6 / 8], 0.4])
"""Share of each bet in the capital, as logarithm. With it, n values of 0 give a bound of about 3.3 / n."""
DOUBT = 0.05
"""Probability that the bound is below the mean, unless another is given."""
HALVINGS = 50
"""Halvings of the interval of the bound. More would reach a mean of 1, at which no bet has a limit."""


def upper_bound(values: Sequence[float] | Float64, doubt: float = DOUBT) -> float:
    r"""Return an upper bound of the mean of a distribution from independent draws.

    For each possible mean :math:`m` a gambler bets that it is too large:

    .. math:: K_t(m) = \sum_j w_j \prod_{i \le t} \left(1 + \frac{c_j}{1 - m} (m - x_i)\right)

    with fixed :math:`0 < c_j \le 1` and :math:`\sum_j w_j = 1`. No factor is negative, and if :math:`m` is the mean,
    :math:`K` is a martingale that begins at 1. By Ville's inequality it ever reaches :math:`1 / \mathrm{doubt}` with a
    probability of at most ``doubt``. The bound is the smallest mean whose capital reached it at any time. As :math:`K`
    increases with :math:`m`, all larger means are excluded as well. This is a mixture of the bets of Waudby-Smith and
    Ramdas (2024), "Estimating means of bounded random variables by betting", JRSS B 86.

    Parameters
    ----------
    values : float64, shape (n,)
        Draws from 0 to 1, in their order.
    doubt : float
        Probability that the bound is below the mean after any of the draws.

    Returns
    -------
    float
        Bound from 0 to 1. It does not increase with further draws, so it holds whenever the sampling stops.
    """
    x = np.asarray(values, np.float64)[:, np.newaxis]
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        m = (low + high) / 2
        with np.errstate(divide="ignore"):
            logs = np.log1p(BETS * (m - x) / (1 - m)).cumsum(axis=0)
        capital = np.logaddexp.reduce(logs + LOG_SHARES, axis=1)
        if capital.max(initial=0.0) >= -np.log(doubt):
            high = m
        else:
            low = m
    return high
