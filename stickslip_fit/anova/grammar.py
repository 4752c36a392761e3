"""Model formulas, as in ``step_size ~ C(session) * direction``, parsed into a response and terms.

The notation is that of G. N. Wilkinson and C. E. Rogers, Applied Statistics 22:392 (1973). Text is never
evaluated: a formula consists of names of columns, ``C(name)``, ``log(name)`` and operators, from weakest to
strongest ``~``, ``+ -``, ``* /``, ``:``, ``**``, and nothing else.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import chain
from typing import NoReturn

from stickslip_fit.errors import InputError, shorten

MAX_LENGTH = 1_000  # characters
MAX_DEPTH = 20  # parentheses within parentheses
MAX_TERMS = 64
POWERS = tuple("123456789")
MAX_NAMES_SHOWN = 40
GRAMMAR = 'column names, C(name), log(name), Q("any name"), + - * / : ~ ( ) and ** with a whole number'
FUNCTIONS = ("C", "log", "Q")
_TOKEN = re.compile(
    r"""\s*(?:(?P<name>[^\W\d]\w*)|(?P<number>\d+)|(?P<text>"[^"\n]*"|'[^'\n]*')|(?P<sign>\*\*|[-~+*/:()]))"""
)


@dataclass(frozen=True)
class Factor:
    """A column, as it is or under a function: ``C`` takes its values as labels, ``log`` their logarithms."""

    column: str
    function: str = ""

    @property
    def name(self) -> str:
        """As in a formula.

        Examples
        --------
        >>> Factor("session", "C").name
        'C(session)'
        """
        return f"{self.function}({self.column})" if self.function else self.column


Term = tuple[Factor, ...]
"""The product of factors."""


@dataclass(frozen=True)
class Formula:
    """A response and the terms to explain it by, main effects first, else in the order of the formula."""

    response: Factor
    terms: tuple[Term, ...]


def parse_formula(text: str, columns: Collection[str]) -> Formula:
    """Read a formula over the columns of a table.

    Parameters
    ----------
    columns : collection of str
        Names that it may use.

    Raises
    ------
    InputError
        With the position of what is wrong, for anything outside the grammar, unknown names, and formulas
        that are too long, too deeply nested or have too many terms.

    Examples
    --------
    >>> formula = parse_formula("y ~ (a + b)**2 - b", ("y", "a", "b"))
    >>> [":".join(factor.name for factor in term) for term in formula.terms]
    ['a', 'a:b']
    """
    parser = _Parser(text, columns)
    response = parser.factor()
    parser.expect("~", "after the response")
    terms = parser.sum_of_terms(depth=0)
    if parser.token != "":
        parser.refuse(f"{parser.token!r} does not belong here")
    if not terms:
        parser.refuse("there is nothing after its ~ to look at, e.g. C(session)")
    return Formula(response, tuple(sorted(terms, key=len)))


@dataclass(frozen=True)
class _Token:
    kind: str  # name, number, text, sign, or end
    text: str
    position: int


class _Parser:
    """Recursive descent: one method for each strength of operator."""

    def __init__(self, text: str, columns: Collection[str]) -> None:
        self.text, self.columns, self.index = text, columns, 0
        self.tokens = _tokenize(text)

    @property
    def token(self) -> str:
        """The text of the next token; empty at the end."""
        return self.tokens[self.index].text

    def refuse(self, reason: str) -> NoReturn:
        """Raise the InputError for the next token."""
        _refuse(self.text, self.tokens[self.index].position, reason)

    def take(self) -> _Token:
        """The next token, and go on."""
        token = self.tokens[self.index]
        self.index += token.kind != "end"
        return token

    def expect(self, sign: str, where: str) -> None:
        """Pass over a sign."""
        if self.token != sign or self.tokens[self.index].kind != "sign":
            self.refuse(f"a {sign} is missing {where}")
        self.take()

    def sum_of_terms(self, depth: int) -> tuple[Term, ...]:
        """``a + b - c``; a leading or added 1 is the general mean, which is always there."""
        terms: tuple[Term, ...] = ()
        sign = self.take().text if self.token in ("+", "-") else "+"
        while True:
            if self.tokens[self.index].kind == "number":
                self._check_mean(sign, depth)
            elif sign == "+":
                terms = self._unite(terms, self.product(depth))
            else:
                left_out = {frozenset(term) for term in self.product(depth)}
                terms = tuple(term for term in terms if frozenset(term) not in left_out)
            if self.token not in ("+", "-"):
                return terms
            sign = self.take().text

    def product(self, depth: int) -> tuple[Term, ...]:
        """``a * b`` is a + b + a:b, ``a / b`` is a + a:b."""
        return self._chain(("*", "/"), self.interaction, depth)

    def interaction(self, depth: int) -> tuple[Term, ...]:
        """``a:b``."""
        return self._chain((":",), self.power, depth)

    def _chain(
        self, signs: tuple[str, ...], operand: Callable[[int], tuple[Term, ...]], depth: int
    ) -> tuple[Term, ...]:
        left = operand(depth)
        while self.token in signs:
            sign = self.take().text
            right = operand(depth)
            if sign == ":":
                left = self._cross(left, right)
            elif sign == "*":
                left = self._unite(left, right, self._cross(left, right))
            else:
                every = tuple(dict.fromkeys(factor for term in left for factor in term))
                left = self._unite(left, self._cross((every,), right))
        return left

    def power(self, depth: int) -> tuple[Term, ...]:
        """``(a + b + c)**2`` is all products of at most two of them."""
        base = result = self.operand(depth)
        while self.token == "**":
            self.take()
            exponent = self.tokens[self.index]
            if exponent.text not in POWERS:
                self.refuse(f"** takes a whole number from 1 to {POWERS[-1]}")
            self.take()
            for _ in range(1, min(int(exponent.text), len(base))):
                result = self._unite(result, self._cross(result, base))
            base = result
        return result

    def operand(self, depth: int) -> tuple[Term, ...]:
        """A factor, or a sum in parentheses."""
        if self.token != "(":
            return ((self.factor(),),)
        if depth == MAX_DEPTH:
            self.refuse(f"parentheses are nested more than {MAX_DEPTH} deep")
        self.take()
        terms = self.sum_of_terms(depth + 1)
        self.expect(")", "to close a parenthesis")
        return terms

    def factor(self) -> Factor:
        """``name``, ``C(name)``, ``log(name)``, or a name in quotes within ``Q("...")``."""
        position = self.index
        token = self.take()
        if token.kind != "name":
            self.index = position
            self.refuse(
                "the formula ends where a name belongs"
                if token.kind == "end"
                else f"{token.text!r} is no name"
            )
        if self.token != "(":
            return Factor(self._known(token))
        if token.text not in FUNCTIONS:
            self.index = position
            self.refuse(f"{shorten(token.text)!r} is no function of a formula")
        self.take()
        if token.text == "Q":
            factor = Factor(self._quoted())
        elif self.token == "Q":
            self.take()
            self.expect("(", "after Q")
            factor = Factor(self._quoted(), token.text)
            self.expect(")", "after the name")
        else:
            if self.tokens[self.index].kind != "name":
                self.refuse(f"{token.text}(...) takes the name of one column")
            factor = Factor(self._known(self.take()), token.text)
        self.expect(")", "after the name")
        return factor

    def _quoted(self) -> str:
        if self.tokens[self.index].kind != "text":
            self.refuse("Q(...) takes the name of a column in quotes")
        token = self.take()
        return self._known(_Token(token.kind, token.text[1:-1], token.position))

    def _known(self, token: _Token) -> str:
        if token.text in self.columns:
            return token.text
        similar = get_close_matches(shorten(token.text), self.columns, 1)
        hint = f"did you mean {similar[0]}? " if similar else ""
        names = sorted(self.columns)
        shown = ", ".join(map(shorten, names[:MAX_NAMES_SHOWN]))
        more = f" and {len(names) - MAX_NAMES_SHOWN:,} more" if len(names) > MAX_NAMES_SHOWN else ""
        reason = f"{shorten(token.text)!r} is no column; {hint}there are {shown}{more}"
        _refuse(self.text, token.position, reason)

    def _check_mean(self, sign: str, depth: int) -> None:
        """Pass over ``+ 1``; refuse every other number."""
        number = self.tokens[self.index].text
        if number not in ("0", "1"):
            self.refuse(f"{shorten(number)} stands for nothing; a number follows ** only")
        if (sign, number) != ("+", "1") or depth:
            self.refuse("this leaves out the general mean; drop the 0 or -1")
        self.take()

    def _unite(self, *sums: Iterable[Term]) -> tuple[Term, ...]:
        """All terms, each once."""
        united: dict[frozenset[Factor], Term] = {}
        for term in chain.from_iterable(sums):
            united.setdefault(frozenset(term), term)
            if len(united) > MAX_TERMS:
                self.refuse(f"the formula comes to more than {MAX_TERMS} terms; leave some out")
        return tuple(united.values())

    def _cross(self, left: tuple[Term, ...], right: tuple[Term, ...]) -> tuple[Term, ...]:
        """The products of each term of `left` and each of `right`."""
        return self._unite(tuple(dict.fromkeys((*one, *other))) for one in left for other in right)


def _tokenize(text: str) -> list[_Token]:
    if len(text) > MAX_LENGTH:
        raise InputError(f"the formula has {len(text):,} characters, more than {MAX_LENGTH:,}; shorten it")
    tokens, position, end = [], 0, len(text.rstrip())
    while position < end:
        match = _TOKEN.match(text, position)
        if match is None or match.lastgroup is None:
            position += len(text[position:]) - len(text[position:].lstrip())
            _refuse(text, position, f"{text[position]!r} is not part of a formula")
        tokens.append(_Token(match.lastgroup, match[match.lastgroup], match.start(match.lastgroup)))
        position = match.end()
    return [*tokens, _Token("end", "", end)]


def _refuse(text: str, position: int, reason: str) -> NoReturn:
    raise InputError(
        f"the formula {shorten(text)!r} cannot be used: at character {position + 1}, {reason}. "
        f"A formula has {GRAMMAR}, e.g. step_size ~ C(session) * direction"
    )
