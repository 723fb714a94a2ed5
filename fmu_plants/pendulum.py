r"""The pendulum of the paper: equation (22), as printed.

.. math::
    \dot x_1 &= x_2 \\
    \dot x_2 &= -\frac{g}{r} \sin x_1 - \frac{k}{m r} x_2 + \frac{\tau}{m r}

with angle :math:`x_1`, angular velocity :math:`x_2`, torque :math:`\tau`; m = 1 kg, r = 0.2 m, g = 9.81 m/s2.
The damping k = 0.4 is not in the paper; it is taken from the program that its authors published.

Newton's law for a point mass has m r^2 under k and the torque where the paper prints m r; the units below
follow the meaning of the variables. `torque_gain` multiplies the torque: a change of its sign reverses the
direction of control.
"""

from math import degrees

from fmu_plants import DisplayUnit, Equations, Parameter, PlantModel, Symbols, Variable, tunable

ANGLE = Variable(
    "angle",
    "rad",
    nominal=1.0,
    description="Angle to the vertical, 0 hanging",
    display_unit=DisplayUnit("deg", degrees(1)),
)
ANGULAR_VELOCITY = Variable(
    "angular_velocity",
    "rad/s",
    nominal=1.0,
    description="Angular velocity",
    display_unit=DisplayUnit("deg/s", degrees(1)),
)
TORQUE = Variable("torque", "N.m", nominal=1.0, description="Applied torque")


def equations(v: Symbols) -> Equations:
    """Return the right-hand side of (22)."""
    from sympy import sin  # reading the plant's variables must not cost SymPy's import

    inertia = v.mass * v.radius
    acceleration = (
        -v.gravity / v.radius * sin(v.angle)
        - v.damping / inertia * v.angular_velocity
        + v.torque_gain * v.torque / inertia
    )
    return Equations(derivatives={"angle": v.angular_velocity, "angular_velocity": acceleration})


MODEL = PlantModel(
    name="pendulum",
    description="Pendulum driven by a torque",
    source=(
        'S. Rezaei, A. Khaki-Sedigh: "Comparative Analysis of Data-Driven Predictive Control Strategies", '
        "ICCIA 2023, equation (22); damping from the authors' published program"
    ),
    states=(ANGLE, ANGULAR_VELOCITY),
    inputs=(TORQUE,),
    outputs=(ANGLE, ANGULAR_VELOCITY),
    parameters=(
        tunable("mass", "kg", min=1e-3, start=1.0, description="Mass m"),
        tunable("radius", "m", min=1e-3, start=0.2, description="Length r"),
        tunable("damping", "N.m.s/rad", min=0.0, start=0.4, description="Damping k"),
        tunable("torque_gain", start=1.0, description="Factor on the torque"),
        Parameter(
            "gravity", "m/s2", min=0.0, nominal=10.0, start=9.81, description="Acceleration of gravity g"
        ),
    ),
    equations=equations,
    step_size=0.1,
    stop_time=40.0,
)
