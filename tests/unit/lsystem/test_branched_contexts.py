"""Right contexts with branches: the example of ABOP section 1.8, and a matcher on trees as the oracle."""

from __future__ import annotations

from itertools import accumulate, combinations
from random import Random

from hypothesis import given, settings
from hypothesis import strategies as st

from forestgen.lsystem.compiler import compile_program
from forestgen.lsystem.derivation import derive
from forestgen.lsystem.multiset import words_as_text
from forestgen.lsystem.parsing import parse_text

Axis = list["str | Axis"]  # modules, and the branches between them


def word(text: str) -> str:
    *_, last = derive(compile_program(parse_text(text, "test.lsys")), 1, 0)
    (only,) = words_as_text(last.multiset)
    return only


def test_the_example_of_the_book() -> None:
    """ABOP p. 32: [DE] is passed on the way to the left context, I[JK]L on the way to the right one."""
    axiom = "axiom: ABC[DE][SG[HI[JK]L]MNO]\n"
    assert word(axiom + "BC < S > G[H]M --> X") == "ABC[DE][XG[HI[JK]L]MNO]"
    for missing in ("BC < S > G[I]M", "BC < S > G[H]N", "BC < S > G[HM]", "C < S > [H]M", "BC < S > G[H][H]M"):
        assert word(axiom + f"{missing} --> X") == "ABC[DE][SG[HI[JK]L]MNO]"
    for found in ("S > G[HI[J]]MN", "S > G[HI[]L]MNO", "S > G[]", "S > GM"):
        assert word(axiom + f"{found} --> X") == "ABC[DE][XG[HI[JK]L]MNO]"


def test_parameters_in_branches_reach_condition_and_successor() -> None:
    rule = "A(x) > [B(y)C(c)][B(z)] : z > y --> A(x + 10*y + 100*z + 1000*c)\n"
    assert word(f"axiom: A(1)[B(2)C(4)][B(3)]\n{rule}") == "A(4321)[B(2)C(4)][B(3)]"
    assert word(f"axiom: A(1)[B(3)C(4)][B(2)]\n{rule}") == "A(1)[B(3)C(4)][B(2)]"
    assert word(f"axiom: A(1)[D[B(9)]][B(7)][B(2)D][B(2)C(4)]B(1)[B(5)]\n{rule}").startswith("A(1)")
    assert word(f"axiom: A(1)[D][B(7)][B(2)D][B(2)C(4)][D][B(5)]B(1)\n{rule}").startswith("A(4521)")


def test_ignore_and_consider_hold_within_branches() -> None:
    rule = "A > [BC]D --> X\n"
    assert word(f"axiom: A[+B-C]-D\n{rule}") == "A[+B-C]-D"
    assert word(f"ignore: +-\naxiom: A[+B-C]-D\n{rule}") == "X[+B-C]-D"
    assert word(f"consider: ABCD\naxiom: A[+B[F]FC]FD\n{rule}") == "X[+B[F]FC]FD"


def test_a_branch_that_begins_like_the_context_does_not_hide_the_next() -> None:
    """The inner branch fits twice in the outer branch that fails."""
    assert word("axiom: A[B[C]D][B[C]E]\nA > [B[C]E] --> X") == "X[B[C]D][B[C]E]"
    assert word("axiom: A[B[C]D][B[F]E]\nA > [B[C]E] --> X") == "A[B[C]D][B[F]E]"
    assert word("axiom: P[A[B]]B[B]\nA > [B][B] --> X") == "P[A[B]]B[B]"  # the module's own branch ends


# --- the oracle: contexts and words as trees, every choice of branches tried


def tree(text: str) -> Axis:
    root: Axis = []
    open_axes = [root]
    for character in text:
        if character == "[":
            branch: Axis = []
            open_axes[-1].append(branch)
            open_axes.append(branch)
        elif character == "]":
            open_axes.pop()
        else:
            open_axes[-1].append(character)
    return root


def node(axis: Axis) -> tuple[list[Axis], str | None, Axis]:
    """The branches before an axis's next module that is seen, that module, and what follows it."""
    branches: list[Axis] = []
    for k, one in enumerate(axis):
        if isinstance(one, list):
            branches.append(one)
        elif one not in "+-":
            return branches, one, axis[k + 1 :]
    return branches, None, []


def is_subtree(context: Axis, axis: Axis) -> bool:
    wanted, module, rest = node(context)
    there, next_module, what_follows = node(axis)
    if module is not None and (module != next_module or not is_subtree(rest, what_follows)):
        return False
    return any(all(map(is_subtree, wanted, chosen)) for chosen in combinations(there, len(wanted)))


def rewritten(axis: Axis, path: str, left: str, head: str, context: Axis) -> str:
    """The word in which each head in its context is X; `path` are the modules seen from the root to here."""
    text = ""
    for k, one in enumerate(axis):
        if isinstance(one, list):
            text += f"[{rewritten(one, path, left, head, context)}]"
            continue
        matches = one == head and path.endswith(left) and is_subtree(context, axis[k + 1 :])
        text += "X" if matches else one
        path += one if one not in "+-" else ""
    return text


def strings(symbols: str, size: int) -> st.SearchStrategy[str]:
    return st.recursive(
        st.sampled_from(symbols),
        lambda inner: st.lists(inner | inner.map(lambda s: f"[{s}]"), min_size=1, max_size=4).map("".join),
        max_leaves=size,
    )


def part_of(axis: Axis, choose: Random) -> str:
    """A context that the axis fits: branches and ends left out; at times with another module."""
    text = ""
    for one in axis:
        if isinstance(one, list):
            text += f"[{part_of(one, choose)}]" if choose.random() < 0.6 else ""
        elif one not in "+-":
            text += choose.choice("AB") if choose.random() < 0.1 else one
            if choose.random() < 0.2:
                break
    return text


@settings(max_examples=400, deadline=None)
@given(text=strings("ABAB+-", 24), left=st.text("AB", max_size=2), choose=st.randoms(use_true_random=False))
def test_contexts_match_as_trees_do(text: str, left: str, choose: Random) -> None:
    text = f"A{text}"
    k = choose.choice([k for k, symbol in enumerate(text) if symbol in "AB"])
    depths = list(accumulate((one == "[") - (one == "]") for one in text[k:]))
    end = next((k + n for n, depth in enumerate(depths) if depth < 0), len(text))  # of the head's branch
    head, right = text[k], part_of(tree(text[k + 1 : end]), choose) or "B"
    rule = f"{left} < {head} > {right} --> X" if left else f"{head} > {right} --> X"
    assert word(f"ignore: +-\naxiom: {text}\n{rule}") == rewritten(tree(text), "", left, head, tree(right))
