"""Figures of others, as printed, and some measured earlier; none of them by the scorecard."""

from __future__ import annotations

from typing import NamedTuple

CHEN = "Chen et al. 2023, Frontiers in Earth Science 10:1015153, table 2"
SITHOLE = "Sithole and Vosselman 2004, ISPRS J. 59"
DONG18 = "Dong et al. 2018, Remote Sensing 10(10):1632, table 4"
DONG17 = "Dong et al. 2017, ISPRS Archives XLII-2/W7:703, table 3; type II from its own counts"
RIDGE = "Remote Sensing 8(1):71, 2016, tables 2 and 3"
EARLIER = "measured earlier by this project on all 15 samples"


class PerSample(NamedTuple):
    """Type I, II, total in percent by ISPRS sample."""

    name: str
    source: str
    samples: dict[str, tuple[float, float, float]]


class Mean(NamedTuple):
    """Type I, II, total, kappa in percent; None where it is not said."""

    name: str
    data: str
    source: str
    type_1: float | None
    type_2: float | None
    total: float | None
    kappa: float | None


class Rmse(NamedTuple):
    """RMSE of DTMs in metres: residential, mountain, both."""

    name: str
    data: str
    source: str
    residential: float
    mountain: float
    both: float


PER_SAMPLE = (
    PerSample("PTD of the chen2023 paper", CHEN, {
        "samp11": (46.68, 3.40, 28.21), "samp12": (15.60, 1.92, 8.93), "samp22": (36.84, 3.23, 26.36),
        "samp24": (40.30, 12.54, 32.67), "samp31": (3.93, 3.55, 3.76), "samp42": (12.13, 1.45, 4.58),
        "samp51": (4.91, 3.80, 4.67), "samp53": (26.66, 1.44, 25.64),
    }),
    PerSample("chen2023 as its paper has it", CHEN, {
        "samp11": (29.87, 7.59, 20.36), "samp12": (15.00, 7.21, 11.20), "samp22": (17.57, 9.43, 15.03),
        "samp24": (17.59, 12.05, 16.07), "samp31": (15.79, 6.31, 11.42), "samp42": (4.31, 2.97, 3.36),
        "samp51": (0.68, 11.27, 2.99), "samp53": (10.35, 3.96, 10.09),
    }),
)  # fmt: skip

VAIHINGEN, COLOURED = (
    "Vaihingen 11 and 32, image matching",
    "a coloured city, vegetation removed first",
)
MEANS = (
    Mean("Axelsson, tuned per sample", "15 ISPRS samples", SITHOLE, None, None, 4.82, None),
    Mean(
        "SMRF, tuned per sample",
        "15 ISPRS samples",
        "Pingel et al. 2013",
        None,
        None,
        2.97,
        None,
    ),
    Mean(
        "Hu et al., tuned per sample",
        "15 ISPRS samples",
        "Hu et al. 2014",
        None,
        None,
        2.85,
        None,
    ),
    Mean(
        "Mongus and Zalik", "15 ISPRS samples", "Mongus and Zalik 2014", None, None, 2.74, None
    ),
    Mean("PTD of the chen2023 paper", "15 ISPRS samples", CHEN, 23.12, 4.02, 16.34, None),
    Mean("chen2023 as its paper has it", "15 ISPRS samples", CHEN, 14.66, 6.76, 11.28, None),
    Mean("PTD of the dong2018 paper", VAIHINGEN, DONG18, 11.81, 7.97, 10.34, None),
    Mean("dong2018 as its paper has it", VAIHINGEN, DONG18, 4.28, 9.46, 6.26, None),
    Mean("dong2017 as its paper has it", COLOURED, DONG17, 0.0, 2.39, 1.53, None),
    Mean("PDAL 2.10 SMRF, default", "15 ISPRS samples", EARLIER, 2.33, 14.85, 5.14, 83.3),
    Mean(
        "PDAL 2.10 SMRF, best one setting", "15 ISPRS samples", EARLIER, 2.84, 10.17, 4.23, 85.8
    ),
    Mean(
        "PDAL 2.10 PMF, best one setting", "15 ISPRS samples", EARLIER, 3.64, 13.57, 6.12, 80.2
    ),
    Mean(
        "lasR 0.21 PTD, best one setting", "15 ISPRS samples", EARLIER, 9.46, 6.11, 7.68, 76.9
    ),
    Mean("CSF, best one setting", "15 ISPRS samples", EARLIER, 15.48, 10.30, 14.31, 63.8),
)

RMSES = (
    Rmse("PTD of the ridge2016 paper", "data set 1, sites 1 to 4", RIDGE, 0.651, 1.645, 1.286),
    Rmse(
        "ridge2016 as its paper has it", "data set 1, sites 1 to 4", RIDGE, 0.396, 1.259, 0.963
    ),
    Rmse("PTD of the ridge2016 paper", "data set 2, sites 5 to 8", RIDGE, 0.710, 1.649, 1.309),
    Rmse(
        "ridge2016 as its paper has it", "data set 2, sites 5 to 8", RIDGE, 0.596, 1.249, 1.007
    ),
)
