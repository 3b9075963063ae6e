"""NASA, "Check-cases for verification of 6-degree-of-freedom flight vehicle simulations", 2015.

[1] is NASA/TM-2015-218675, by E. B. Jackson, R. Shelton, A. A. Jackson, M. D. Madden and others, Engineering and Safety
Center. Its authors ran each case in three to six simulations of NASA's centres and published the trajectories. `data/`
contains one sample per second of these. A case holds if each signal computed here stays within the published ones.
"""
