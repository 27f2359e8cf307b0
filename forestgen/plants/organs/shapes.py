"""Forms of organs, as the `shapes` of a species' file name them: `form` says which, and each has its own keys."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from forestgen.plants.organs.flowers import Acorn, Berry, Bud, Catkin, Cone, Daisy, Disc, FourPetals, Lily
from forestgen.plants.organs.fronds import FanFrond, FernFrond, GrassBlade, GrassPanicle, PalmFrond
from forestgen.plants.organs.leaves import CompoundLeaf, LobedLeaf, PalmateLeaf, SimpleLeaf
from forestgen.plants.organs.needles import Fascicle, NeedleTwig

_Leaf = SimpleLeaf | LobedLeaf | PalmateLeaf | CompoundLeaf | Fascicle | NeedleTwig
_Frond = PalmFrond | FanFrond | FernFrond | GrassBlade | GrassPanicle
_Flower = Daisy | FourPetals | Lily | Catkin | Bud | Berry | Acorn | Cone

#: The form of one kind of organ, told apart by its key `form`.
OrganShape = Annotated[_Leaf | _Frond | _Flower | Disc, Field(discriminator="form")]
