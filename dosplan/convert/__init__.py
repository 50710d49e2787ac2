"""Recorded traffic of other data sets as CommonRoad files.

``sind`` reads a record of SinD and ``lanelet2`` its map, ``windows`` cuts both into files, and
``files`` writes them.
"""
