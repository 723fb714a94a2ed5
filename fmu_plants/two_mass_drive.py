r"""A two-mass drive: motor and load, coupled by an elastic shaft.

.. math::
    J_1 \dot \omega_1 &= \tau - b_1 \omega_1 - \tau_s \\
    J_2 \dot \omega_2 &= \tau_s - b_2 \omega_2 - \tau_L \\
    \dot \varphi &= \omega_1 - \omega_2 \\
    \tau_s &= c \varphi + d (\omega_1 - \omega_2)

with speeds :math:`\omega_1` of the motor and :math:`\omega_2` of the load, twist :math:`\varphi` of the
shaft, motor torque :math:`\tau` and load torque :math:`\tau_L` (a disturbance). The equations are those of
G. Zhang, J. Furusho, "Speed control of two-inertia system by PI/PID control", IEEE Trans. Industrial
Electronics 47 (2000) 603-609, with friction and shaft damping added. The values are not of a published
plant: they are chosen for a lightly damped resonance at 9 Hz.
"""

from math import pi

from fmu_plants import DisplayUnit, Equations, Parameter, PlantModel, Symbols, Variable, tunable

_RPM = DisplayUnit("rpm", 30.0 / pi)

MOTOR_SPEED = Variable(
    "motor_speed", "rad/s", nominal=10.0, description="Speed of the motor", display_unit=_RPM
)
LOAD_SPEED = Variable("load_speed", "rad/s", nominal=10.0, description="Speed of the load", display_unit=_RPM)
TWIST = Variable(
    "twist", "rad", nominal=0.1, description="Twist of the shaft", display_unit=DisplayUnit("deg", 180.0 / pi)
)
MOTOR_TORQUE = Variable("motor_torque", "N.m", -5.0, 5.0, description="Torque of the motor")
LOAD_TORQUE = Variable("load_torque", "N.m", -5.0, 5.0, description="Torque that the load takes")


def equations(v: Symbols) -> Equations:
    """Return the right-hand side above."""
    difference = v.motor_speed - v.load_speed
    shaft_torque = v.stiffness * v.twist + v.shaft_damping * difference
    return Equations(
        {
            "motor_speed": (v.motor_torque - v.motor_friction * v.motor_speed - shaft_torque)
            / v.motor_inertia,
            "load_speed": (shaft_torque - v.load_friction * v.load_speed - v.load_torque) / v.load_inertia,
            "twist": difference,
        }
    )


MODEL = PlantModel(
    name="two_mass_drive",
    description="Motor and load coupled by an elastic shaft",
    source="G. Zhang, J. Furusho, IEEE Trans. Industrial Electronics 47 (2000) 603-609; values chosen here",
    states=(MOTOR_SPEED, LOAD_SPEED, TWIST),
    inputs=(MOTOR_TORQUE, LOAD_TORQUE),
    outputs=(LOAD_SPEED, MOTOR_SPEED),
    parameters=(
        Parameter("motor_inertia", "kg.m2", 1e-6, start=0.02, nominal=0.01, description="Inertia J_1"),
        tunable("load_inertia", "kg.m2", 1e-6, start=0.03, nominal=0.01, description="Inertia J_2"),
        tunable(
            "stiffness", "N.m/rad", 0.0, start=40.0, nominal=10.0, description="Stiffness c of the shaft"
        ),
        tunable(
            "shaft_damping", "N.m.s/rad", 0.0, start=0.05, nominal=0.01, description="Damping d of the shaft"
        ),
        tunable("motor_friction", "N.m.s/rad", 0.0, start=0.01, nominal=0.01, description="Friction b_1"),
        tunable("load_friction", "N.m.s/rad", 0.0, start=0.02, nominal=0.01, description="Friction b_2"),
    ),
    equations=equations,
    step_size=0.01,
    stop_time=5.0,
)
