"""SI multipliers: write ``3.5 * mm``, divide by a unit to read a result in it.

Everything inside rvjax is SI (m, rad, N, N m, kg, s, Pa); these are plain floats.
"""

import math

mm = 1e-3
um = 1e-6
deg = math.pi / 180
arcmin = deg / 60
arcsec = deg / 3600
rpm = 2 * math.pi / 60
MPa = 1e6
GPa = 1e9
