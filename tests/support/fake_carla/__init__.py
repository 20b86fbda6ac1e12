"""A stand-in for CARLA's client library and the simulator behind it.

Values (transforms, boxes, weather, settings, enumerations) are the real library's; only
what needs a simulator is made here. `test_fake_library` compares every signature.
"""
