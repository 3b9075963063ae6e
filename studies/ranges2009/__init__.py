"""J. Djugash, B. Hamner, S. Roth, "Navigating with ranging radios: five data sets with ground truth", 2009.

[1] in its files (Journal of Field Robotics 26). Two of its logs, Plaza1 and Plaza2, lie in the wheel of gtsam (BSD): a
vehicle on wheels among four ultra-wideband radios. They are written as logs of trimtab, its filters are stepped over
them, and their errors are compared with the truth and with a batch solution by gtsam (tests/oracles/ranges2009.py).
"""
