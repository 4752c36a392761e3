"""An emulated rig: controller, manipulator with hidden laws, and sound."""
