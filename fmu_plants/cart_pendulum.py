r"""An inverted pendulum on a cart: unstable at its upright equilibrium, where it begins.

.. math::
    (M + m) \ddot p + b \dot p - m l \ddot\theta \cos\theta + m l \dot\theta^2 \sin\theta &= F \\
    (I + m l^2) \ddot\theta - m g l \sin\theta &= m l \ddot p \cos\theta

with position :math:`p` of the cart, angle :math:`\theta` of the pendulum to the upright, and force
:math:`F` on the cart. Control Tutorials for MATLAB and Simulink (University of Michigan), "Inverted
Pendulum: System Modeling", with the angle counted from the upright instead of from hanging: M = 0.5 kg, m =
0.2 kg, b = 0.1 N.s/m, l = 0.3 m (to the centre of mass), I = 0.006 kg.m2.
"""

from math import degrees

from fmu_plants import DisplayUnit, Equations, Parameter, PlantModel, Symbols, Variable, tunable

POSITION = Variable("position", "m", nominal=0.1, description="Position p of the cart")
VELOCITY = Variable("velocity", "m/s", description="Velocity of the cart")
ANGLE = Variable(
    "angle",
    "rad",
    nominal=0.1,
    description="Angle theta to the upright",
    display_unit=DisplayUnit("deg", degrees(1)),
)
ANGULAR_VELOCITY = Variable(
    "angular_velocity",
    "rad/s",
    description="Angular velocity",
    display_unit=DisplayUnit("deg/s", degrees(1)),
)
FORCE = Variable("force", "N", -10.0, 10.0, description="Force F on the cart")


def equations(v: Symbols) -> Equations:
    """Return the equations above, solved for both accelerations."""
    from sympy import cos, sin  # reading the plant's variables must not cost SymPy's import

    moment = v.pendulum_mass * v.length
    total_mass = v.cart_mass + v.pendulum_mass
    inertia = v.inertia + moment * v.length
    push = v.force - v.friction * v.velocity - moment * v.angular_velocity**2 * sin(v.angle)
    fall = moment * v.gravity * sin(v.angle)
    coupling = moment * cos(v.angle)
    determinant = total_mass * inertia - coupling**2
    return Equations(
        {
            "position": v.velocity,
            "velocity": (inertia * push + coupling * fall) / determinant,
            "angle": v.angular_velocity,
            "angular_velocity": (total_mass * fall + coupling * push) / determinant,
        }
    )


MODEL = PlantModel(
    name="cart_pendulum",
    description="Inverted pendulum on a cart",
    source='Control Tutorials for MATLAB and Simulink, University of Michigan: "Inverted Pendulum"',
    states=(POSITION, VELOCITY, ANGLE, ANGULAR_VELOCITY),
    inputs=(FORCE,),
    outputs=(POSITION, ANGLE, VELOCITY, ANGULAR_VELOCITY),
    parameters=(
        tunable("cart_mass", "kg", 1e-3, start=0.5, description="Mass M of the cart"),
        tunable("pendulum_mass", "kg", 1e-3, start=0.2, description="Mass m of the pendulum"),
        Parameter("length", "m", 1e-3, start=0.3, description="Length l to the centre of mass"),
        Parameter(
            "inertia", "kg.m2", 0.0, start=0.006, nominal=0.01, description="Inertia I of the pendulum"
        ),
        tunable("friction", "N.s/m", 0.0, start=0.1, description="Friction b of the cart"),
        Parameter("gravity", "m/s2", 0.0, start=9.81, nominal=10.0, description="Acceleration of gravity g"),
    ),
    equations=equations,
    step_size=0.02,
    stop_time=10.0,
)
