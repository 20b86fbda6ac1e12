"""A stand-in for CARLA's Python client library and the simulator behind it.

Value types (transforms, boxes, weather, settings, enumerations) are the real library's;
only what needs a running simulator is made here. `test_fake_library` compares the
signatures of all methods with the real ones.
"""
