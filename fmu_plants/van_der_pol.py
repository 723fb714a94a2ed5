r"""The Van der Pol oscillator, forced.

.. math::
    \dot x_1 &= x_2 \\
    \dot x_2 &= \mu (1 - x_1^2) x_2 - \omega_0^2 x_1 + u

with position :math:`x_1`, velocity :math:`x_2` and force per mass :math:`u`; mu = 1 1/s, omega_0 = 1 rad/s
as in textbooks (H. K. Khalil, "Nonlinear Systems", 3rd ed., 2002, section 1.2.4). Without force, the origin
is an unstable equilibrium and every other motion ends on one limit cycle, of amplitude 2 nearly.
"""

from fmu_plants import Equations, PlantModel, Symbols, Variable, tunable

POSITION = Variable("position", nominal=2.0, description="Position")
VELOCITY = Variable("velocity", "1/s", nominal=2.0, description="Velocity")
FORCE = Variable("force", "1/s2", description="Force per mass")


def equations(v: Symbols) -> Equations:
    """Return the right-hand side above."""
    acceleration = v.damping * (1 - v.position**2) * v.velocity - v.stiffness * v.position + v.force
    return Equations(derivatives={"position": v.velocity, "velocity": acceleration})


MODEL = PlantModel(
    name="van_der_pol",
    description="Van der Pol oscillator driven by a force",
    source='B. van der Pol: "On relaxation-oscillations", Phil. Mag. 2 (1926) 978-992',
    states=(POSITION, VELOCITY),
    inputs=(FORCE,),
    outputs=(POSITION, VELOCITY),
    parameters=(
        tunable("damping", "1/s", min=0.0, start=1.0, description="Negative damping mu at the origin"),
        tunable("stiffness", "1/s2", min=0.0, start=1.0, description="Stiffness per mass, omega_0 squared"),
    ),
    equations=equations,
    step_size=0.1,
    stop_time=20.0,
)
