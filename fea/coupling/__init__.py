"""How the rigid side holds the section of the deformable body.

A coupling adds a few unknowns, the *border*, to the body's free nodes: the interface displacement
(and multipliers). The body's stiffness stays sparse and positive definite; the border is eliminated
last, by its Schur complement, which is also where the 6x6 tangent compliance comes from.

All vectors are in the undeformed interface frame, its origin at the interface point.
"""

from wrenchbook.fea.coupling.bushing import Mounted
from wrenchbook.fea.coupling.coupling import Border, CoupledState, Coupling
from wrenchbook.fea.coupling.distributed import Distributed
from wrenchbook.fea.coupling.rigid import Rigid

__all__ = ["Border", "CoupledState", "Coupling", "Distributed", "Mounted", "Rigid"]
