"""A compiled L-system: one table of whole numbers and one of real numbers, laid out as `machine` reads them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.lsystem.multiset import Kind
from forestgen.lsystem.syntax import Listing, Place


@dataclass(frozen=True)
class RuleSet:
    """A set of productions: where the machine finds it, and how much it writes."""

    address: int  # in the table of whole numbers: for each kind, where its productions begin; -1: there are none
    most_modules: NDArray[np.int64]  # (number of kinds,) written for a module of a kind, at most
    most_values: NDArray[np.int64]  # (number of kinds,) parameters of these


@dataclass(frozen=True)
class Program:
    """An L-system, ready to run."""

    listing: Listing
    kinds: tuple[Kind, ...]
    whole: NDArray[np.int64]  # code, productions, arities: see machine.py
    real: NDArray[np.float64]  # constants, global and local variables, arrays, functions, stack
    productions: RuleSet
    decomposition: RuleSet
    interpretation: RuleSet
    decomposition_depth: int
    interpretation_depth: int
    has_contexts: bool
    longest_successor: tuple[int, int]  # modules and parameters
    longest_context: int
    axiom: tuple[int, ...]  # where each word's code begins
    axiom_size: tuple[tuple[int, int], ...]  # modules and parameters of each word
    start: int  # where code begins that runs before the derivation; -1: none
    start_each: int  # before each step
    end_each: int  # after each step
    globals_at: int  # in `real`
    globals: tuple[str, ...]  # names; the first is the current group
    groups: frozenset[int]
    counted: tuple[tuple[int, str], ...]  # globals that hold the number of modules of a symbol
    code_at: int  # in `whole`
    places: tuple[Place, ...]  # of each instruction
    derivation_length: int | None

    @property
    def name(self) -> str:
        return self.listing.name

    def place_of(self, address: int) -> Place:
        """Where in the text the instruction at an address comes from."""
        return self.places[(address - self.code_at) // 2]
