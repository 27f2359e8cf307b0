"""What derivation does, whatever the program: properties, and statistics of the random ones."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from forestgen.core.errors import LsystemError
from forestgen.lsystem.codegen import fold
from forestgen.lsystem.compiler import Program, compile_program, with_values
from forestgen.lsystem.derivation import Derivation, axiom, derive, derive_step, interpret
from forestgen.lsystem.multiset import Multiset, show_number, words_as_lists, words_as_text
from forestgen.lsystem.parsing import parse_text
from support.error_messages import raises_error


def compiled(text: str) -> Program:
    return compile_program(parse_text(text, "test.lsys"))


def last(text: str, steps: int, seed: int = 0) -> Multiset:
    *_, found = derive(compiled(text), steps, seed)
    return found.multiset


def words(text: str, steps: int, seed: int = 0) -> list[str]:
    return list(words_as_text(last(text, steps, seed)))


# --- a slow reference: context-free productions, one module after another


branches = st.deferred(
    lambda: st.lists(st.sampled_from("ABC") | branches.map(lambda s: f"[{s}]"), max_size=4).map("".join)
)


def split(text: str) -> list[str]:
    """The pieces of a word with %, by recursion over its branches: the piece that holds the begin, then the others."""
    numbered: list[list[str]] = [[]]
    outer: list[int] = []
    current = 0
    for character in text:
        if character == "%":
            numbered.append([])
            current = len(numbered) - 1
            continue
        if character == "]":
            current = outer.pop()
        numbered[current].append(character)
        if character == "[":
            outer.append(current)
    return ["".join(piece) for piece in numbered if piece]


@settings(max_examples=60, deadline=None)
@given(start=branches, a=branches, b=branches, steps=st.integers(0, 4))
def test_parallel_rewriting_is_sequential_on_context_free_grammars(start: str, a: str, b: str, steps: int) -> None:
    expected = start
    for _ in range(steps):
        expected = "".join({"A": a, "B": b}.get(character, character) for character in expected)
    if len(expected) > 5000:
        return
    plain = f"axiom: {start}\nA --> {a or '*'}\nB --> {b or '*'}"
    general = plain.replace(" -->", " : 1 -->") + "\ndecomposition\nX --> Y"  # neither shortcut is taken
    for text in (plain, general):
        assert words(text, steps) == ([expected] if expected else [])
    assert expected.count("[") == expected.count("]")


@settings(max_examples=60, deadline=None)
@given(parts=st.lists(branches, min_size=1, max_size=5), inner=st.lists(branches, min_size=1, max_size=3))
def test_fragmentation_loses_and_invents_no_module(parts: list[str], inner: list[str]) -> None:
    text = f"{'%'.join(parts)}A[{'%'.join(inner)}]B"
    found = words(f"axiom: {{ S }}\nS --> {text}", 1)
    assert Counter("".join(found)) == Counter(text.replace("%", ""))
    assert found == split(text)
    for word in found:
        depth = np.cumsum([(c == "[") - (c == "]") for c in word])
        assert depth.min(initial=0) >= 0
        assert len(word) == 0 or depth[-1] == 0


def test_cut_removes_the_rest_of_the_branch() -> None:
    assert words("axiom: S\nS --> A[BC%D[E]F]G%H[I]", 1) == ["A[BC]G"]
    assert words("axiom: S\nS --> A(1)[B(2)%C(3)D(4)]E(5)", 1) == ["A(1)[B(2)]E(5)"]


@settings(max_examples=200, deadline=None)
@given(st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_read_back(value: float) -> None:
    text = show_number(value)
    assert float(text) == value
    ((module,),) = parse_text(f"axiom: A({text})", "test").axiom
    assert fold(module.arguments[0], {}, "test") == value


def test_written_forms() -> None:
    text = "axiom: A(2)[B(0.5)]-(30)F"
    assert words(text, 0) == ["A(2)[B(0.5)]-(30)F"]
    assert words_as_lists(last(text, 0)) == [[["A", 2.0], ["["], ["B", 0.5], ["]"], ["-", 30.0], ["F"]]]
    assert last(text, 0).counts() == {"A": 1, "[": 1, "B": 1, "]": 1, "-": 1, "F": 1}


# --- expressions


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("1+2*3", 7),
        ("(1+2)*3", 9),
        ("2^3^2", 512),
        ("-2^2", -4),
        ("7 % 4", 3),
        ("-7 % 4", -3),
        ("10/4/5", 0.5),
        ("sin(30)", 0.5),
        ("cos(60)", 0.5),
        ("tan(45)", 1),
        ("asin(1)", 90),
        ("acos(0)", 90),
        ("atan(1)", 45),
        ("atan2(1, -1)", 135),
        ("exp(0)+log(1)", 1),
        ("log10(1000)", 3),
        ("pow(2, 10)", 1024),
        ("min(3, 4)*max(5, 6)", 18),
        ("floor(-1.5)", -2),
        ("ceil(1.2)", 2),
        ("trunc(-1.7)", -1),
        ("abs(-3)+sign(-2)", 2),
        ("1 < 2 && 2 <= 2 && 3 > 2 && 2 >= 2", 1),
        ("1 == 2 || 1 != 1", 0),
        ("!0 + !5", 1),
        ("0 && 1/x", 0),
        ("5 || 1/x", 1),
        ("twice(3) + y", 7),
        ("func(1, 0.5)", 0.5),
        ("func(ramp, 2)", 1),
        ("r[1] + r[x]", 30),
    ],
)  # fmt: skip
def test_expressions(expression: str, value: float) -> None:
    text = "#define y 1\n#define twice(a) (2*a)\nfunction ramp: (0,0) (1,1)\ndefine: { array r[2] = {10, 20}; }\n"
    found = last(f"{text}axiom: A(0)\nA(x) --> B({expression})", 1)
    assert found.parameter[0] == pytest.approx(value, abs=1e-12)


def test_a_function_is_the_spline_of_its_control_points() -> None:
    """A clamped cubic B-spline of four control points is the Bezier curve."""
    t = np.linspace(0, 1, 9)
    bezier = [3 * (1 - t) ** 2 * t * a + 3 * (1 - t) * t**2 * b + t**3 * c for a, b, c in ((0.2, 0.6, 1), (2, -1, 1))]
    text = "function 1: (0,0) (0.2,2) (0.6,-1) (1,1)\naxiom: " + "".join(f"A({x!r})" for x in bezier[0].tolist())
    found = last(text + "\nA(x) --> A(func(1,x))", 1).parameter
    assert np.allclose(found, bezier[1], atol=2e-4)


def test_statements() -> None:
    text = """axiom: A(5)
A(x) : {h = x / 2; if (h > 2) { k = 1; } else k = 2;} k == 1 {m = h * 10;} --> B(h, m)
"""
    assert words(text, 1) == ["B(2.5,25)"]


def test_productions_in_order_and_conditions() -> None:
    text = "axiom: A(1)A(5)A(9)\nA(x) : x > 8 --> H\nA(x) : x > 4 --> M\nA(x) --> L"
    assert words(text, 1) == ["LMH"]


def test_context_parameters_reach_the_successor() -> None:
    assert words("axiom: A(1)B(2)C(3)\nA(x) < B(y) > C(z) --> D(x+10*y+100*z)", 1) == ["A(1)D(321)C(3)"]


def test_consider_and_ignore() -> None:
    rules = "A < B --> C\n"
    assert words("axiom: A+B\n" + rules, 1) == ["A+B"]
    assert words("ignore: +-\naxiom: A+B\n" + rules, 1) == ["A+C"]
    assert words("consider: AB\naxiom: AFFB\n" + rules, 1) == ["AFFC"]


def test_groups_are_tables() -> None:
    """A table L-system: the table changes with the step."""
    text = """start: {n = 0;}
starteach: {n = n + 1; if (n % 2 == 0) useGroup(2); else useGroup(1);}
axiom: AX
X --> XY
group 1:
A --> AB
endgroup
group 2:
A --> AC
endgroup
"""
    assert words(text, 3) == ["ABCBXYYY"]


def test_a_table_that_waits_for_the_word() -> None:
    """Tables chosen by what is in the word: growth halts until no signal is left (Streit et al. 2005, appendix)."""
    text = """starteach: {if (count(V) > 0) useGroup(2); else useGroup(1);}
axiom: A
group 1:
A --> V(2)A
endgroup
group 2:
V(n) : n > 0 --> V(n-1)
V(n) --> F
endgroup
"""
    program = compiled(text)
    assert ["".join(words_as_text(s.multiset)) for s in derive(program, 5, 0)] == [
        "A", "V(2)A", "V(1)A", "V(0)A", "FA", "FV(2)A",
    ]  # fmt: skip


def test_interpretation_is_for_drawing_only() -> None:
    program = compiled("axiom: A\nA --> AA\ninterpretation\nA --> F[+L]\nL --> {ff}\n")
    state = derive_step(program, axiom(program, 0), 0)
    assert list(words_as_text(state.multiset)) == ["AA"]
    assert list(words_as_text(interpret(program, state, 0))) == ["F[+L]F[+L]"]
    deeper = compiled("axiom: A\ninterpretation\nmaximum depth: 2\nA --> F[+L]\nL --> {ff}\n")
    assert list(words_as_text(interpret(deeper, axiom(deeper, 0), 0))) == ["F[+{ff}]"]


def test_decomposition_runs_within_the_step_and_on_the_axiom() -> None:
    text = "axiom: S(2)\nA --> S(1)\ndecomposition\nS(n) : n > 0 --> AS(n-1)\nS(n) --> *"
    assert [words(text, n) for n in (0, 1)] == [["AA"], ["AA"]]


# --- environment


def test_the_environment_gets_parameters_and_gives_others() -> None:
    program = compiled("axiom: { T(3)?E(0,7), T(4)?E(0,8) }\nT(x)?E(a,b) --> T(x+a)?E(0,b)")

    def environment(found: Multiset) -> Multiset:
        values = found.parameter.copy()
        values[1::3] = values[0::3] * 100 + values[2::3]
        return replace(found, parameter=values)

    start = axiom(program, 0)
    after = derive_step(program, replace(start, multiset=environment(start.multiset)), 0)
    state = replace(after, multiset=environment(after.multiset))
    assert list(words_as_text(state.multiset)) == ["T(310)?E(31007,7)", "T(412)?E(41208,8)"]


# --- randomness


def test_stochastic_productions_take_their_probabilities() -> None:
    text = "axiom: " + "A" * 1000 + "\nA --> B : 0.2\nA --> C : 0.5\nA --> D : 0.1\n"
    found = Counter("".join("".join(words(text, 1, seed)) for seed in range(40)))
    chi = stats.chisquare([found[s] for s in "BCDA"], 40_000 * np.array([0.2, 0.5, 0.1, 0.2]))
    assert chi.pvalue > 1e-4
    rest = Counter("".join(words(text + "A --> E\n", 1)))
    assert rest["A"] == 0
    assert 120 < rest["E"] < 280


@pytest.mark.parametrize(
    ("expression", "distribution"),
    [("ran(3)", stats.uniform(0, 3)), ("nran(2,0.5)", stats.norm(2, 0.5))],
)
def test_continuous_random_numbers(expression: str, distribution: object) -> None:
    text = f"axiom: A(20000)\ndecomposition\nA(n) : n > 0 --> B({expression})A(n-1)\nA(n) --> *"
    values = last(text, 0, 11).parameter
    assert len(values) == 20_000
    assert stats.kstest(values, distribution.cdf).pvalue > 1e-4  # type: ignore[attr-defined]
    assert abs(np.corrcoef(values[:-1], values[1:])[0, 1]) < 0.03


@pytest.mark.parametrize("mean", [0.0, 0.3, 4.0, 9.99, 10.01, 57.0, 3000.0])
def test_poisson_numbers(mean: float) -> None:
    text = f"axiom: A(20000)\ndecomposition\nA(n) : n > 0 --> B(poisson({mean}))A(n-1)\nA(n) --> *"
    values = last(text, 0, 5).parameter.astype(int)
    assert values.mean() == pytest.approx(mean, abs=5 * np.sqrt(max(mean, 1e-9) / 20_000))
    if mean:
        cells = np.unique(stats.poisson(mean).ppf(np.linspace(0.02, 0.98, 12)))
        edges = np.concatenate([[-1], cells, [np.inf]])
        expected = np.diff(stats.poisson(mean).cdf(edges)) * len(values)
        found = np.histogram(values, edges + 0.5)[0]
        assert stats.chisquare(found, expected).pvalue > 1e-4


def test_random_numbers_belong_to_the_word_and_not_to_its_place() -> None:
    """The order of words, and what becomes of the others, changes nothing."""
    program = compiled("axiom: { T(0), T(0), T(0) }\nT(x) --> T(ran(1))")
    start = axiom(program, 3)
    straight = derive_step(program, start, 3).multiset
    turned = replace(start.multiset, word_id=start.multiset.word_id[::-1].copy())
    reverse = derive_step(program, Derivation(turned, 0, start.next_id, start.globals), 3).multiset
    assert np.array_equal(straight.parameter, reverse.parameter[::-1])
    assert len(set(straight.parameter)) == 3


def test_same_seed_same_words_other_seed_others() -> None:
    text = "axiom: A(1)\nA(x) --> B(ran(1))A(nran(0,1)) : 0.5\nA(x) --> C[A(ran(x^2))] : 0.5"
    assert words(text, 8, 1) == words(text, 8, 1)
    assert words(text, 8, 1) != words(text, 8, 2)


# --- identity of words


def test_a_word_keeps_its_id_and_pieces_get_new_ones() -> None:
    program = compiled("axiom: { A, B }\nA --> I[B]A\nB --> B%A")
    state = axiom(program, 0)
    ids = [state.multiset.word_id.tolist()]
    for _ in range(3):
        state = derive_step(program, state, 0)
        ids.append(state.multiset.word_id.tolist())
        assert len(set(ids[-1])) == len(ids[-1])
    # Step 1: A becomes I[B]A, which begins otherwise: a new word. B stays, and sends A off.
    assert ids[:2] == [[1, 2], [3, 2, 4]]
    assert ids[2][0] == 3
    assert 2 in ids[2]


def test_values_from_outside() -> None:
    listing = parse_text(
        "#define n 3\ndefine: { array r = {1, 2}; }\nfunction 1: (0,0) (1,1)\naxiom: A(n,r[1],func(1,0.5))", "t"
    )
    program = compile_program(with_values(listing, {"n": 5.0, "r": (7.0, 8.0, 9.0), "1": ((0.0, 4.0), (1.0, 4.0))}))
    assert list(words_as_text(axiom(program, 0).multiset)) == ["A(5,8,4)"]


# --- queries


def test_queries_tell_where_the_turtle_stands() -> None:
    text = "angle: 90\nstep: 2\naxiom: F[+F?P(0,0,0)]F?P(0,0)?H(0,0,0)\nF --> FF\n"
    found = words(text, 0) + words(text, 1)
    numbers = [[float(n) for n in piece.split(")")[0].split(",")] for w in found for piece in w.split("(")[1:]]
    # Heading starts upwards; + turns towards the left, -x.
    expected = [[-2, 0, 2], [0, 0], [0, 0, 1], [-4, 0, 4], [0, 0], [0, 0, 1]]
    assert [np.allclose(a, b, atol=1e-12) for a, b in zip(numbers, expected, strict=True)] == [True] * 6


def test_pruning_in_a_box_by_queries() -> None:
    """Growth stops where a query says that it has left a box (Prusinkiewicz et al. 1994)."""
    text = """axiom: A?P(0,0,0)
A > ?P(x,y,z) : z < 4.5 --> FA
A > ?P(x,y,z) : z >= 4.5 --> T
"""
    assert words(text, 20) == ["FFFFFT?P(0,0,5)"]


def test_queries_count_what_the_interpretation_draws() -> None:
    found = words("axiom: L?P(0,0,0)\ninterpretation\nL --> F(3)f(4)", 0)
    assert found == ["L?P(0,0,7)"]


# --- what a review found


@pytest.mark.parametrize("rule", ["A --> B", "A : 1 --> B", "A > C --> B", "A --> B : 1"])
def test_what_a_production_writes_is_decomposed_in_the_same_step(rule: str) -> None:
    assert words(f"axiom: AC\n{rule}\ndecomposition\nB --> DE", 1) == ["DEC"]


def test_a_variable_that_no_branch_sets_is_zero() -> None:
    text = "axiom: A(2)A(0)A(2)\nA(x) : {if (x > 1) k = 7;} 1 --> B(k)"
    assert words(text, 1) == ["B(7)B(0)B(7)"]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("#define x 0\naxiom: A(4)\nA(x) --> A(1/x)", "A(0.25)"),
        ("#define y 0\n#define f(y) (1/y)\naxiom: A(4)\nA(x) --> A(f(x))", "A(0.25)"),
        ("#define p 3\naxiom: A(1)\nA(p) --> B : p", "B"),
        ("#define y 0\naxiom: A(4)\nA(x) : {y2 = x;} 1 --> A(y2 + y)", "A(4)"),
    ],
)
def test_parameters_hide_defines(text: str, found: str) -> None:
    assert words(text, 1) == [found]


def test_fragments_of_the_axiom() -> None:
    assert words("axiom: { A%B }", 0) == ["A", "B"]
    assert words("axiom: A[B%C]D", 0) == ["A[B]D"]


def test_commas_in_plain_words_are_modules() -> None:
    assert words("axiom: A,B\nA --> C,", 1) == ["C,,B"]


def test_the_number_of_cores_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    from forestgen.core import threads

    text = """axiom: { S(30000) }
A(x,n)?E(c) : ran(1) < 0.3 --> A(x + ran(1), n)?E(c)%A(ran(9), nran(0,1))?E(poisson(3))
A(x,n)?E(c) : ran(1) < 0.2 --> *
A(x,n) --> A(x, n+1)
decomposition
S(n) : n >= 2 --> S(floor(n/2))S(n-floor(n/2))
S(n) --> %A(ran(1), 0)?E(0)
"""
    made = []
    for cores in (1, 2, 3):
        monkeypatch.setattr(threads, "cores", lambda cores=cores: cores)
        *_, state = derive(compiled(text), 3, 5)
        made.append(state)
    assert len(made[0].multiset) > 30_000
    for other in made[1:]:
        assert other.next_id == made[0].next_id
        for name in ("code", "parameter", "word_start", "word_id", "born_step"):
            assert np.array_equal(getattr(other.multiset, name), getattr(made[0].multiset, name)), name
    assert len(set(made[0].multiset.word_id.tolist())) == len(made[0].multiset)


@settings(max_examples=40, deadline=None)
@given(parts=st.lists(branches, min_size=1, max_size=4))
def test_fragmentation_keeps_parameters_with_their_modules(parts: list[str]) -> None:
    text = "%".join(parts) + "A"
    numbered, counter = "", 0
    for character in text:
        counter += character.isalpha()
        numbered += f"{character}({counter})" if character.isalpha() else character
    found = words(f"axiom: {{ S }}\nS --> {numbered}", 1)
    expected = dict(enumerate((c for c in text if c.isalpha()), 1))
    seen = [
        (int(piece.split("(")[1]), piece[0])
        for w in found
        for piece in w.replace("[", "").replace("]", "").split(")")[:-1]
    ]
    assert dict(seen) == expected
    assert len(seen) == len(expected)
    assert ["".join(c for c in w if not c.isdigit() and c not in "()") for w in found] == split(text)


def test_functions_have_the_numbers_of_their_names() -> None:
    text = "function 2: (0,5) (1,5)\nfunction named: (0,9) (1,9)\nfunction 7: (0,7) (1,7)\n"
    assert words(text + "axiom: A(func(2,0),func(7,0),func(named,0),func(1,0))", 0) == ["A(5,7,9,9)"]
    assert words(text + "axiom: A(7)\nA(n) --> A(func(n,0))", 1) == ["A(7)"]
    with raises_error(LsystemError, place="test.lsys:5:12"):
        words(text + "axiom: A(3)\nA(n) --> A(func(n,0))", 1)


def test_productions_may_follow_a_block() -> None:
    assert words("axiom: A\ninterpretation\nA --> F\nproductions:\nA --> AA", 2) == ["AAAA"]


# --- what an attacker found


def test_a_define_goes_before_a_function_of_the_same_name() -> None:
    text = "#define max(a,b) (a+b)\n#define k max(1,2)\naxiom: A(max(1,2))B(k)C(1)\nC(x) --> C(max(x,2))"
    assert words(text, 1) == ["A(3)B(3)C(3)"]


@pytest.mark.parametrize("name", ["floor", "ceil", "trunc"])
def test_rounding_large_numbers(name: str) -> None:
    found = last(f"axiom: A(1e19)B(-1e300)\nA(x) --> A({name}(x))\nB(x) --> B({name}(x))", 1).parameter
    assert found.tolist() == [1e19, -1e300]


def test_a_macro_in_its_own_argument() -> None:
    assert words("#define f(x) (x+1)\naxiom: A(1)\nA(x) --> A(f(f(x)))", 1) == ["A(3)"]


def test_the_right_side_of_a_decided_or_never_runs() -> None:
    assert words("axiom: A(1)\nA(x) : 5 || 1/0 --> B", 1) == ["B"]


def test_functions_keep_their_capitals() -> None:
    assert words("function Ramp: (0,0) (1,1)\naxiom: A(func(Ramp,0.5))", 0) == ["A(0.5)"]


def test_doubling_defines_are_computed_once() -> None:
    doubling = "#define a0 (1+1)\n" + "".join(f"#define a{i} (a{i - 1}+a{i - 1})\n" for i in range(1, 40))
    assert words(doubling + "axiom: A(a39)", 0) == [f"A({2**40})"]


def test_long_statements_are_read_in_linear_time() -> None:
    assert len(words("axiom: A\n" + "  A\n" * 50_000, 0)[0]) == 50_001
