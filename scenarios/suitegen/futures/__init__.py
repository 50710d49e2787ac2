"""How suite 2 was made: scenes of SUMO traffic whose past has several futures.

``kinds`` draws a scene and what its actors may do, ``staging`` says what a scene is made of,
``demand`` tells SUMO who is in it, ``simulate`` drives it once for each future, ``motion`` turns
traces into poses, ``scene`` rejects what no road user does, and ``build`` calls them in order.
"""
