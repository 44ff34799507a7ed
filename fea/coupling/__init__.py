"""The connection of the rigid side to the section of the deformable body.

A coupling adds a few unknowns, the *border*, to the body's free nodes: the interface displacement
(and multipliers). The body's stiffness stays sparse and positive definite; the border is eliminated
last, by its Schur complement, which also gives the tangent compliance, 6x6 an interface.

The body is in the undeformed frame of the first interface, its origin at that interface's point.
The displacement and the wrench of each interface are in that interface's frame.
"""

from wrenchbook.fea.coupling.coupling import Border, CoupledState, Coupling
from wrenchbook.fea.coupling.section import Distributed, Rigid

__all__ = ["Border", "CoupledState", "Coupling", "Distributed", "Rigid"]
