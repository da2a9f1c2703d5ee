"""Thresholds of what a session is enough for."""

#: Least number of levels of a photon transfer curve: two make a slope, a third shows whether the
#: variance follows the signal (EMVA 1288 Release 4.0, 6.5, demands 50)
LEVELS = 3
#: Least MTF50 of a camera without a tube that is in focus, cy/px. A lens at f/16 has .16 at 550 nm
#: on pixels of 3.45 µm, and pixels below 2 µm at f/16 are used by nobody
LEAST_MTF50_CY_PER_PX = 0.08
