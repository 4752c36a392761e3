"""An arm in which no two numbers agree, and the same arm in an independent physics engine."""

import tomllib

import numpy as np
import pytest

from stickslip_fit.machine import load_machine

# The nominal arm has equal moments here and there, which would hide one taken for another.
ODD_ARM = """
name = "odd arm"
[geometry]
a1_mm = 17.0
l2_mm = 41.0
[range]
q1_deg = [-130, 110]
q2_deg = [-200, 40]
q3_mm = [-3, 19]
[[link]]
mass_g = 23.0
com_mm = 5.0
inertia_g_mm2 = [2100.0, 2700.0, 3300.0]
[[link]]
mass_g = 13.0
com_mm = 11.0
inertia_g_mm2 = [1900.0, 1500.0, 2500.0]
[[link]]
mass_g = 7.0
com_mm = 16.0
inertia_g_mm2 = [1300.0, 1100.0, 900.0]
"""

MJCF = """
<mujoco>
  <compiler angle="radian" eulerseq="xyz" inertiafromgeom="false"/>
  <option gravity="0 0 -9.80665"/>
  <worldbody>
    <body name="base">
      <body pos="{a1} 0 0" euler="1.5707963267948966 0 0">
        <joint type="hinge" pos="-{a1} 0 0" axis="0 1 0"/>
        <inertial pos="-{com[0]} 0 0" mass="{mass[0]}" diaginertia="{inertia[0]}"/>
        <body euler="-1.5707963267948966 0 0">
          <joint type="hinge" axis="0 -1 0"/>
          <inertial pos="0 0 {com[1]}" mass="{mass[1]}" diaginertia="{inertia[1]}"/>
          <body name="hand" pos="0 0 {l2}">
            <joint type="slide" axis="0 0 1"/>
            <inertial pos="0 0 -{com[2]}" mass="{mass[2]}" diaginertia="{inertia[2]}"/>
            <site name="tip"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


class Engine:
    """MuJoCo's arm. The engine is fed grams and millimetres from the TOML text, converted here."""

    def __init__(self, text):
        mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed (the extra peers)")

        content = tomllib.loads(text)
        links = content["link"]
        self.mujoco = mujoco
        self.model = mujoco.MjModel.from_xml_string(
            MJCF.format(
                a1=content["geometry"]["a1_mm"] / 1e3,
                l2=content["geometry"]["l2_mm"] / 1e3,
                com=[link["com_mm"] / 1e3 for link in links],
                mass=[link["mass_g"] / 1e3 for link in links],
                inertia=[" ".join(repr(x / 1e9) for x in link["inertia_g_mm2"]) for link in links],
            )
        )
        self.data = mujoco.MjData(self.model)
        self.tip_site = self.model.site("tip").id

    def put(self, q, qdot=(0.0, 0.0, 0.0), theta=0.0, psi=0.0):
        """Stand the arm at q, moving at qdot, on a base turned by Rx(theta) Ry(psi)."""
        about_x, about_y = np.zeros(4), np.zeros(4)
        self.mujoco.mju_axisAngle2Quat(about_x, np.array([1.0, 0.0, 0.0]), theta)
        self.mujoco.mju_axisAngle2Quat(about_y, np.array([0.0, 1.0, 0.0]), psi)
        self.mujoco.mju_mulQuat(self.model.body("base").quat, about_x, about_y)
        self.data.qpos[:], self.data.qvel[:] = q, qdot
        self.mujoco.mj_forward(self.model, self.data)

    def tip(self):
        return self.data.site_xpos[self.tip_site].copy()

    def jacobian(self):
        slopes = np.zeros((3, 3))
        self.mujoco.mj_jacSite(self.model, self.data, slopes, None, self.tip_site)
        return slopes

    def inertia(self):
        full = np.zeros((3, 3))
        self.mujoco.mj_fullM(self.model, self.data, full)
        return full

    def bias(self):
        """Coriolis, centrifugal and gravity forces, C qdot + G."""
        return self.data.qfrc_bias.copy()


@pytest.fixture(scope="session")
def nominal():
    return load_machine()


@pytest.fixture(scope="session")
def arm(machine_of):
    return machine_of(ODD_ARM)


@pytest.fixture(scope="session")
def engine():
    return Engine(ODD_ARM)


@pytest.fixture(scope="session")
def states(arm):
    """40 random (q, qdot, theta, psi): positions in range, rates that make every term of motion count."""
    rng = np.random.default_rng(1)
    low, high = np.array([arm.ranges[joint] for joint in (1, 2, 3)]).T
    q = rng.uniform(low, high, size=(40, 3))
    qdot = rng.normal(size=(40, 3)) * [30.0, 30.0, 1.0]
    theta, psi = rng.uniform(-np.pi, np.pi, size=(2, 40))
    return q, qdot, theta, psi
