"""Plants written once as equations, exported as FMUs.

The public names stand in ``__init__.pyi``; each is imported when it is first used.

>>> from fmu_plants import export_fmu
>>> from fmu_plants.pendulum import MODEL
>>> export_fmu(MODEL, "pendulum.fmu")  # doctest: +SKIP
PosixPath('pendulum.fmu')
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
