"""NASA, "Check-cases for verification of 6-degree-of-freedom flight vehicle simulations", 2015.

[1] is NASA/TM-2015-218675, by E. B. Jackson, R. Shelton, A. A. Jackson, M. D. Madden and others, Engineering and Safety
Center. It flew each case in three to six simulations of NASA's own centres, and published their trajectories; `data/`
holds every second of them. A case holds where each of our signals stays among theirs.
"""
