"""Formulas: what they may hold, that nothing in them is run, and that values and derivatives are right."""

import pickle
import string
import time

import numpy as np
import pytest

from stickslip_fit import InputError
from stickslip_fit._expression import FUNCTIONS, MAX_LENGTH, parse_expression, parse_formula

X = {
    "x": np.linspace(0.1, 0.9, 7),
    "y": np.linspace(-0.8, 0.7, 7),
    "a": np.float64(1.3),
    "b": np.float64(0.4),
}
BY_HAND = {
    "a + b*x - y/2": lambda x, y, a, b: a + b * x - y / 2,
    "-x**2 + (-x)**3": lambda x, y, a, b: -(x**2) + (-x) ** 3,
    "a*exp(-x/b) + log(x) + sqrt(x)": lambda x, y, a, b: a * np.exp(-x / b) + np.log(x) + np.sqrt(x),
    "a*log10(b*x)": lambda x, y, a, b: a * np.log10(b * x),
    "sin(a*x)*cos(b*y) + tan(x*b)": lambda x, y, a, b: np.sin(a * x) * np.cos(b * y) + np.tan(x * b),
    "arcsin(b*y) + arccos(b*x) + arctan(a*y)": (
        lambda x, y, a, b: np.arcsin(b * y) + np.arccos(b * x) + np.arctan(a * y)
    ),
    "sinh(a*y) + cosh(b*x) + tanh(a*x)": lambda x, y, a, b: np.sinh(a * y) + np.cosh(b * x) + np.tanh(a * x),
    "arctan2(a*y, b*x) + log1p(a*x) + expm1(b*y)": (
        lambda x, y, a, b: np.arctan2(a * y, b * x) + np.log1p(a * x) + np.expm1(b * y)
    ),
    "abs(a*y) + sign(y)*b + step(y + 0.01)*a": (
        lambda x, y, a, b: np.abs(a * y) + np.sign(y) * b + np.heaviside(y + 0.01, 0.5) * a
    ),
    "min(a*x, b, y) + max(x*b, y*a)": (
        lambda x, y, a, b: np.minimum(np.minimum(a * x, b), y) + np.maximum(x * b, y * a)
    ),
    "x**a + (x/b)**(a + b) + 2**x + x**-2 + x**0.5": (
        lambda x, y, a, b: x**a + (x / b) ** (a + b) + 2**x + x**-2.0 + x**0.5
    ),
    "pi*x + 3": lambda x, y, a, b: np.pi * x + 3,
}


@pytest.mark.parametrize("text", BY_HAND)
def test_values_are_those_of_numpy_and_derivatives_those_of_differences(text):
    function = BY_HAND[text]
    value, slopes = parse_expression(text).function(("a", "b", "x"))(X)
    np.testing.assert_allclose(value, function(**X), rtol=1e-14)
    for k, name in enumerate(("a", "b", "x")):
        upper, lower = ({**X, name: X[name] + h} for h in (1e-6, -1e-6))
        numerical = (function(**upper) - function(**lower)) / 2e-6
        np.testing.assert_allclose(slopes[:, k], numerical, rtol=1e-7, atol=1e-7)


def test_keywords_of_python_are_names_like_any_other():
    """A yield, a wavelength and a class of steel are common columns and parameters."""
    expression = parse_expression("yield*sin(2*pi*x/lambda) + Q('from') - class")
    assert expression.names == ("yield", "x", "lambda", "from", "class")
    value = expression.evaluate({"yield": 2.0, "x": 0.25, "lambda": 1.0, "from": 5.0, "class": 4.0})
    assert value == pytest.approx(3.0)
    with pytest.raises(InputError, match="character 8, it cannot be read"):
        parse_expression("lambda x: x")


@pytest.mark.parametrize(
    "name", ["exp", "sin", "cos", "tan", "sinh", "cosh", "tanh", "log", "sqrt", "arctan"]
)
def test_derivatives_agree_with_the_complex_step(name):
    x = np.linspace(0.2, 0.8, 5)
    _, slopes = parse_expression(f"{name}(k*x)*k").function(("k",))({"x": x, "k": 0.7})
    k = 0.7 + 1e-100j
    np.testing.assert_allclose(slopes[:, 0], (getattr(np, name)(k * x) * k).imag / 1e-100, rtol=1e-13)


@pytest.mark.parametrize("text", [*BY_HAND, "a*b*x", "(a + b)*x", "abs(a)*x", "x*sign(a)", "step(a*x - b)"])
def test_slopes_move_where_second_differences_are_not_zero(text):
    names, rng = ("a", "b"), np.random.default_rng(0)
    evaluate = parse_expression(text).function()
    places = {name: rng.uniform(-2.0, 2.0, (400, 1)) for name in names}
    moved = np.zeros((2, 2), dtype=bool)
    for i, j in np.ndindex(2, 2):
        steps = [np.eye(2)[i] * 0.3, np.eye(2)[j] * 0.4]

        def at(*some, steps=steps):
            by = sum((steps[one] for one in some), np.zeros(2))
            return evaluate(X | {name: places[name] + by[k] for k, name in enumerate(names)})[0]

        parts = at(0, 1), at(0), at(1), at()
        second = np.abs(parts[0] - parts[1] - parts[2] + parts[3]) / (1e-9 + sum(map(np.abs, parts)))
        moved[i, j] = np.nanmax(second) > 1e-9
    np.testing.assert_array_equal(parse_expression(text).slopes_that_move(names), moved)


def test_a_power_of_zero_has_a_derivative_by_its_exponent():
    value, slopes = parse_expression("abs(v)**d").function(("d",))({"v": np.array([0.0, 2.0]), "d": 1.5})
    np.testing.assert_allclose(value, [0.0, 2.0**1.5])
    np.testing.assert_allclose(slopes[:, 0], [0.0, 2.0**1.5 * np.log(2.0)])


def test_names_are_those_of_the_text():
    expression = parse_expression('b*x + step(step) + Q("vel (m/s)")*a + µ + pi')
    assert expression.names == ("b", "x", "step", "vel (m/s)", "a", "µ")
    assert parse_expression("a + b - b").active_names == {"a"}
    assert parse_expression("\n a\n + b").names == ("a", "b")


def test_formulas_are_split_at_their_tilde():
    left, right = parse_formula('Q("a~b") ~ log(x) + 1')
    assert (left.names, right.names) == (("a~b",), ("x",))
    with pytest.raises(InputError, match="a ~ is missing"):
        parse_formula("a + b")
    with pytest.raises(InputError, match="character 9"):
        parse_formula("F ~ a + @")
    with pytest.raises(InputError, match="one ~ only"):
        parse_formula("F ~ ~ a")


def test_expressions_can_be_pickled_after_use():
    expression = parse_expression("a*x")
    expression.evaluate(X)
    assert pickle.loads(pickle.dumps(expression)) == expression


REFUSED = {
    "__import__('os').system('true')": "character 1",
    "x.__class__": "not part of a formula",
    "np.sin(x)": r"write sin\(...\) alone",
    "open(x)": "'open' is no function",
    "(lambda: x)()": "character 8, it cannot be read",
    "[x for x in y]": "not part of a formula",
    "x if y else a": "not part of a formula",
    "x and y": "not part of a formula",
    "x < y": "not part of a formula",
    "x[0]": "not part of a formula",
    "f'{x}'": "not part of a formula",
    "(x := 3)": "not part of a formula",
    "'text'": "not part of a formula",
    "True": "not part of a formula",
    "1j": "not part of a formula",
    "x^2": r"a power is written \*\*",
    "x // 2": "not part of a formula",
    "sin(x, y)": "takes 1 argument",
    "sin(x=2)": "takes 1 argument",
    "max(x)": "takes 2 or more",
    "Q(x)": "in quotes",
    "1e999": "numbers are at most",
    "9" * 400: "numbers are at most",
    "9**9**9": "character 4.*powers within powers",
    "((x**9)**9)**9": "powers within powers",
    "exp(1e5)": "no finite number",
    "1/0": "no finite number",
    "x/0": "divides by zero",
    "x/(y - y)": "divides by zero",
    "sqrt(-1)": "no finite number",
    "-" * 60 + "x": "nested more than",
    "(" * 300 + "x" + ")" * 300: "cannot be",
    "+".join(["x"] * 300): "more than 400",
    "x + ": "cannot be read",
    "": "an expression is missing",
    "x" * (MAX_LENGTH + 1): "shorten it",
    "x\0": "cannot be read",
}


@pytest.mark.parametrize("text", REFUSED, ids=range(len(REFUSED)))
def test_what_is_outside_the_grammar_is_refused_with_its_place(text):
    with pytest.raises(InputError, match=REFUSED[text]):
        parse_expression(text)


WORDS = [
    *FUNCTIONS,
    *[
        *("x", "y", "a", "b", "1", "2.5", "1e300", "1e-300", "0", "64", "-1", "+", "-", "*", "/", "**"),
        *("(", ")", "(", ")", ",", "~", ".", "=", "==", ":", ";", "[", "]", "{", "}", "'", '"', "\\"),
        *("@", "#", "µ"),
    ],
    *["lambda", "import", "exec", "eval", ".__class__", "if", "else", "for", "in", "await", "yield"],
    *("__import__('os').mkdir('run')", "Q('c')", "\n", " "),
]


def random_text(rng):
    if rng.random() < 0.2:
        return "".join(rng.choice(list(string.printable), size=rng.integers(1, 40)))
    if rng.random() < 0.5:
        return " ".join(rng.choice(WORDS, size=rng.integers(1, 25)))
    return random_expression(rng, int(rng.integers(1, 7)))


def random_expression(rng, depth):
    if depth == 0:
        return str(rng.choice(["x", "y", "a", "b", "2", "0.5", "3e10", "-1", "7"]))
    kind = rng.integers(4)
    one, other = (random_expression(rng, depth - 1) for _ in range(2))
    if kind == 0:
        return f"{rng.choice([*FUNCTIONS])}({one})"
    if kind == 1:
        return f"{rng.choice(['min', 'max', 'arctan2'])}({one}, {other})"
    return f"({one} {rng.choice(['+', '-', '*', '/', '**'])} {other})"


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "number"), [(1, 200), pytest.param(2, 10_000, marks=pytest.mark.nightly)])
def test_random_texts_are_refused_or_read_and_never_run(seed, number, tmp_path, monkeypatch):
    """None of them makes the folder that some of them would make if they were run, or takes long."""
    monkeypatch.chdir(tmp_path)
    rng, read = np.random.default_rng(seed), 0
    for _ in range(number):
        text, begin = random_text(rng), time.process_time()
        try:
            expression = parse_expression(text)
            quantities = {name: X.get(name, X["x"]) for name in expression.names}
            value, slopes = expression.function(expression.names)(quantities)
            assert slopes.shape == (*value.shape, len(expression.names))
            read += 1
        except InputError:
            pass
        assert time.process_time() - begin < 1.0, text
    assert read > number / 10
    assert not list(tmp_path.iterdir())
