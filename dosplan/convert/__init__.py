"""Recorded traffic of other data sets as CommonRoad files.

``windows`` finds the moments at which a car of a record can become the ego, and ``episodes`` makes
scenarios of them. Records come from SinD's tables (``sind``, with the map from ``lanelet2``,
written by ``sind_files``) or from files that other converters wrote in CommonRoad's format
(``commonroad``).
"""
