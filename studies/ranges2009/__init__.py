"""J. Djugash, B. Hamner, S. Roth, "Navigating with ranging radios: five data sets with ground truth", 2009.

The study's files cite it as [1] (Journal of Field Robotics 26). Two of its logs, Plaza1 and Plaza2, are in the wheel of
gtsam (BSD): a wheeled vehicle among four ultra-wideband radios. The study converts them to logs of trimtab, runs
trimtab's filters on them, and compares the estimates with the truth and with a batch solution by gtsam
(tests/oracles/ranges2009.py).
"""
