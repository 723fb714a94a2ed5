r"""A position servo with dry friction: it sticks, breaks away at more torque than it slides with, and slides.

.. math::
    \dot\varphi &= \omega \\
    J \dot\omega &= \tau - \gamma_1 \left(\tanh \gamma_2 \omega - \tanh \gamma_3 \omega\right)
                    - \gamma_4 \tanh \gamma_5 \omega - \gamma_6 \omega

with angle :math:`\varphi`, speed :math:`\omega` and torque :math:`\tau`. The friction is that of C. Makkar,
W. E. Dixon, W. G. Sawyer, G. Hu, "A new continuously differentiable friction model for control systems
design", IEEE/ASME Int. Conf. Advanced Intelligent Mechatronics, 2005, pp. 600-605: Stribeck effect, Coulomb
friction, viscous friction. It has no jump: what sticks creeps, here with 0.01 rad/s at 0.55 N.m. The values
are not of a published plant: they are chosen so that it breaks away at 0.69 N.m, of 3 N.m that the motor has,
and slides on from 0.57 N.m.
"""

from math import degrees

from fmu_plants import DisplayUnit, Equations, Parameter, PlantModel, Symbols, Variable, tunable

ANGLE = Variable("angle", "rad", description="Angle of the load", display_unit=DisplayUnit("deg", degrees(1)))
SPEED = Variable(
    "speed", "rad/s", description="Speed of the load", display_unit=DisplayUnit("deg/s", degrees(1))
)
TORQUE = Variable("torque", "N.m", -3.0, 3.0, description="Torque of the motor")


def equations(v: Symbols) -> Equations:
    """Return the right-hand side above."""
    from sympy import tanh  # reading the plant's variables must not cost SymPy's import

    stribeck = v.stribeck_torque * (tanh(v.stribeck_rise * v.speed) - tanh(v.stribeck_fall * v.speed))
    coulomb = v.coulomb_torque * tanh(v.coulomb_rise * v.speed)
    friction = stribeck + coulomb + v.viscous_friction * v.speed
    return Equations({"angle": v.speed, "speed": (v.torque - friction) / v.inertia})


MODEL = PlantModel(
    name="servo",
    description="Position servo with dry friction",
    source=(
        "friction of C. Makkar, W. E. Dixon, W. G. Sawyer, G. Hu, IEEE/ASME Int. Conf. Advanced Intelligent "
        "Mechatronics, 2005, pp. 600-605; values chosen here"
    ),
    states=(ANGLE, SPEED),
    inputs=(TORQUE,),
    outputs=(ANGLE, SPEED),
    parameters=(
        tunable("inertia", "kg.m2", 1e-6, start=0.05, nominal=0.1, description="Inertia J"),
        tunable("stribeck_torque", "N.m", 0.0, start=0.25, nominal=0.1, description="gamma_1"),
        Parameter("stribeck_rise", "s/rad", 0.0, start=100.0, nominal=100.0, description="gamma_2"),
        Parameter("stribeck_fall", "s/rad", 0.0, start=10.0, nominal=10.0, description="gamma_3"),
        tunable("coulomb_torque", "N.m", 0.0, start=0.5, description="gamma_4"),
        Parameter("coulomb_rise", "s/rad", 0.0, start=100.0, nominal=100.0, description="gamma_5"),
        tunable("viscous_friction", "N.m.s/rad", 0.0, start=0.3, nominal=0.1, description="gamma_6"),
    ),
    equations=equations,
    step_size=0.05,
    stop_time=5.0,
)
