"""How the embedded suite was made: SUMO traffic turned into CommonRoad files.

``networks`` draws a road, ``plain`` builds it with netconvert, ``traffic`` drives on it with SUMO,
``motion`` turns SUMO's traces into vehicle poses, ``lanelets`` turns the road into lanelets,
``selection`` picks the ego and the window, ``commonroad_xml`` writes the file and ``verdict`` has
dosplan itself confirm that the scenario is solvable and not trivial. ``build`` calls them in order.
"""
