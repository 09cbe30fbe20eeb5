"""Flat Modelica models: pymoca's syntax tree to declarations and equations of the subset in `README.md`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from antlr4 import CommonTokenStream, InputStream
from antlr4.error.ErrorListener import ErrorListener
from pymoca.generated.ModelicaLexer import ModelicaLexer
from pymoca.generated.ModelicaParser import ModelicaParser as Rules

from fmuid.errors import InputError, ModelicaError
from fmuid.export.syntax import FUNCTIONS, MODIFIERS, Declaration, Equation, Expression, Model
from fmuid.formatting import nearest

_FLAT = "write one flat model"
_SCALARS = "declare and write scalars"
_REAL = "only Real expressions are supported"
_CONDITION = "a relation stands in the condition of an if-expression only"
_RELATIONS = ("<", "<=", ">", ">=")
_CONTINUOUS = "only equations that always hold are supported; use if-expressions"

_REFUSED = {
    Rules.Equation_ifContext: ("if-equation", _CONTINUOUS),
    Rules.Equation_whenContext: ("when-equation", _CONTINUOUS),
    Rules.Equation_forContext: ("for-equation", _SCALARS),
    Rules.Equation_connect_clauseContext: ("connect()", _FLAT),
    Rules.Equation_functionContext: ("call as an equation", "only equations 'a = b' are supported"),
    Rules.Algorithm_sectionContext: ("algorithm section", "write equations"),
    Rules.Expr_relContext: ("relation", _CONDITION),
    Rules.Expr_notContext: ("'not'", _REAL),
    Rules.Expr_andContext: ("'and'", _REAL),
    Rules.Expr_orContext: ("'or'", _REAL),
    Rules.Primary_stringContext: ("string in an expression", _REAL),
    Rules.Primary_trueContext: ("Boolean in an expression", _REAL),
    Rules.Primary_falseContext: ("Boolean in an expression", _REAL),
    Rules.Primary_initialContext: ("initial()", "start values are given by start=... and fixed=true"),
    Rules.Primary_expression_listContext: ("matrix", _SCALARS),
    Rules.Primary_function_argumentsContext: ("array", _SCALARS),
    Rules.Array_subscriptsContext: ("array", _SCALARS),
    Rules.Extends_clauseContext: ("extends", _FLAT),
    Rules.Import_clauseContext: ("import", _FLAT),
    Rules.Replaceable_elementContext: ("replaceable", _FLAT),
    Rules.Element_redeclarationContext: ("redeclare", _FLAT),
    Rules.Condition_attributeContext: ("conditional declaration", "declare it always"),
    Rules.AnnotationContext: ("annotation", "the one supported is the model's experiment annotation"),
}
"""Names of refused rules, and remedies."""


def parse(source: Path) -> Model:
    """Read the one model of a Modelica file."""
    try:
        text = source.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise InputError(f"cannot read {source}: {reason}; give a Modelica file") from None
    lexer = ModelicaLexer(InputStream(text + "\n"))
    parser = Rules(CommonTokenStream(lexer))
    for recogniser in (lexer, parser):
        recogniser.removeErrorListeners()
        recogniser.addErrorListener(_RaisingListener(source.name))
    tree = parser.stored_definition()
    if parser.getCurrentToken().type != -1:  # the grammar stops before anything but a class
        raise ModelicaError(source.name, parser.getCurrentToken().line, "syntax error: expected 'model'")
    return _Walk(source.name).model(tree)


class _RaisingListener(ErrorListener):  # type: ignore[misc]
    """Listener that raises at the first syntax error."""

    def __init__(self, file: str) -> None:
        self.file = file

    def syntaxError(self, recognizer: Any, offendingSymbol: Any, line: int, column: int, msg: str, e: Any) -> None:
        del recognizer, offendingSymbol, e
        what = msg.partition(" expecting {")[0]  # without the list of expected tokens
        raise ModelicaError(self.file, line, f"syntax error at column {column + 1}: {what}")


class _Walk:
    """Walk through the syntax tree of one file."""

    def __init__(self, file: str) -> None:
        self.file = file

    def error(self, rule: Any, what: str, remedy: str) -> ModelicaError:
        line = rule.symbol.line if hasattr(rule, "symbol") else rule.start.line
        return ModelicaError(self.file, line, f"{what} is outside the exported subset: {remedy}")

    def unknown(self, rule: Any) -> ModelicaError:
        return self.error(rule, *_REFUSED.get(type(rule), (f"'{rule.getText()}'", _FLAT)))

    def refuse(self, *rules: Any) -> None:
        """Refuse optional rules that are present."""
        for rule in rules:
            if rule is not None:
                raise self.unknown(rule)

    def model(self, tree: Any) -> Model:
        classes = tree.stored_definition_class()
        if tree.WITHIN() or len(classes) != 1:
            raise self.error(tree, "a file with 'within', several classes or none", "write one model a file")
        definition = classes[0].class_definition()
        specifier = definition.class_specifier()
        kind = _text(definition.class_prefixes())
        if kind != "model" or not isinstance(specifier, Rules.Class_spec_compContext):
            raise self.error(definition, f"this '{kind}'", "write 'model Name ... end Name;'")
        name, end, last = specifier.IDENT(0).getText(), specifier.IDENT(1).getText(), specifier.stop.line
        if name != end:
            raise ModelicaError(self.file, last, f"'end {end}' closes 'model {name}': make the names the same")
        declarations: list[Declaration] = []
        equations: list[Equation] = []
        experiment: tuple[float | None, float | None] = None, None
        for part in specifier.composition().getChildren():
            if isinstance(part, Rules.Element_listContext):
                declarations += [each for element in part.element() for each in self.element(element)]
            elif isinstance(part, Rules.Equation_sectionContext):
                if part.INITIAL():
                    raise self.error(part, "initial equation", "give each state start=... and fixed=true")
                equations += [self.equation(each) for each in part.equation_block().equation()]
            elif isinstance(part, Rules.AnnotationContext):
                experiment = self.experiment(part)
            elif part.getText() != ";":
                raise self.unknown(part)
        description = _comment(specifier.string_comment())
        return Model(self.file, name, description, tuple(declarations), tuple(equations), *experiment, last)

    def experiment(self, rule: Any) -> tuple[float | None, float | None]:
        """Return StopTime and Interval of the experiment annotation, each optional."""
        arguments = self.arguments(rule.class_modification())
        inner = arguments.get("experiment")
        if len(arguments) != 1 or not isinstance(inner, Rules.Modification_classContext):
            raise self.unknown(rule)
        values = {}
        for key, given in self.arguments(inner.class_modification()).items():
            number = self.value(key, given)
            if key not in ("StopTime", "Interval") or number.op != "number" or number.args[0] <= 0:
                raise self.error(given, f"experiment({key}{_text(given)})", "give StopTime and Interval, in s")
            values[key] = number.args[0]
        return values.get("StopTime"), values.get("Interval")

    def element(self, rule: Any) -> list[Declaration]:
        regular = rule.regular_element()
        if regular is None:
            raise self.unknown(rule.getChild(0))
        self.refuse(regular.REDECLARE(), regular.FINAL(), regular.INNER(), regular.OUTER())
        if regular.class_elem is not None:
            raise self.error(rule, f"{_text(regular.class_elem.class_prefixes())} inside the model", _FLAT)
        clause = regular.comp_elem
        role, kind = _text(clause.type_prefix()), _text(clause.type_specifier())
        if (role or "local") not in MODIFIERS or role == "local" or kind != "Real":
            raise self.error(
                clause, f"'{role} {kind}'".replace("' ", "'"), "declare [parameter|constant|input|output] Real"
            )
        self.refuse(clause.array_subscripts())
        declarations = clause.component_list().component_declaration()
        return [self.declaration(each, role or "local") for each in declarations]

    def declaration(self, rule: Any, role: str) -> Declaration:
        inner, comment = rule.declaration(), rule.comment()
        self.refuse(rule.condition_attribute(), inner.array_subscripts(), comment.annotation())
        name, unit, value = self.identifier(inner), None, None
        modifiers: dict[str, Expression] = {}
        modification = inner.modification()
        if isinstance(modification, Rules.Modification_classContext):
            for key, given in self.arguments(modification.class_modification()).items():
                if key not in MODIFIERS[role]:
                    supported = f"{', '.join(MODIFIERS[role])} are supported{nearest(key, MODIFIERS[role])}"
                    raise self.error(given, f"modifier '{key}' of {role} variable '{name}'", supported)
                if key == "unit":
                    unit = _text(given).lstrip("= ")
                    if unit[:1] != '"':
                        raise self.error(given, f"unit={unit}", 'give a string, unit="..."')
                    unit = unit[1:-1]
                elif key == "fixed":
                    if _text(given).lstrip("= ") != "true":
                        raise self.error(given, f"fixed{_text(given)}", "states are fixed=true at their start")
                    modifiers[key] = Expression(given.start.line, "number", (1.0,))
                else:
                    modifiers[key] = self.value(key, given)
        if modification is not None and modification.expression() is not None:
            if role not in ("parameter", "constant") or modification.start.text == ":=":
                raise self.error(inner, f"'{_text(inner)}'", "write it as an equation")
            value = self.expression(modification.expression())
        description = _comment(comment.string_comment())
        return Declaration(name, role, inner.start.line, description, unit, modifiers, value)

    def arguments(self, rule: Any) -> dict[str, Any]:
        """Return the modifications of ``(a=..., b(...))`` by name."""
        result: dict[str, Any] = {}
        for each in rule.argument_list().argument() if rule.argument_list() else []:
            self.refuse(each.element_redeclaration())
            argument = each.element_modification_or_replaceable()
            self.refuse(argument.EACH(), argument.FINAL(), argument.element_replaceable())
            key = _text(argument.element_modification().component_reference())
            if key in result:
                raise ModelicaError(self.file, argument.start.line, f"'{key}' is given twice: remove one")
            result[key] = argument.element_modification().modification()
            if result[key] is None:
                raise self.error(argument, f"'{key}' without a value", f"write {key}=...")
        return result

    def value(self, key: str, rule: Any) -> Expression:
        """Return the expression of ``= expression``."""
        if not isinstance(rule, Rules.Modification_assignmentContext):
            raise self.error(rule, f"'{key}{_text(rule)}'", f"write {key}=...")
        return self.expression(rule.expression())

    def identifier(self, rule: Any) -> str:
        name: str = rule.IDENT().getText()
        if name.startswith("'"):
            raise self.error(rule, f"quoted name {name}", "use letters, digits and underscores")
        return name

    def equation(self, rule: Any) -> Equation:
        options = rule.equation_options()
        if not isinstance(options, Rules.Equation_simpleContext):
            raise self.unknown(options)
        self.refuse(rule.comment().annotation())
        left, right = self.simple(options.simple_expression()), self.expression(options.expression())
        return Equation(options.start.line, left, right)

    def expression(self, rule: Any) -> Expression:
        if isinstance(rule, Rules.Expression_ifContext):
            pairs = zip(rule.conditions, rule.blocks[:-1], strict=True)
            args = [part for condition, value in pairs for part in (self.condition(condition), self.expression(value))]
            return Expression(rule.start.line, "if", (*args, self.expression(rule.blocks[-1])))
        return self.simple(rule.simple_expression())

    def condition(self, rule: Any) -> Expression:
        if isinstance(rule, Rules.Expression_ifContext):
            raise self.error(rule, "if-expression as a condition", "join relations with and, or, not")
        if len(rule.simple_expression().expr()) != 1:
            raise self.error(rule, "range", _SCALARS)
        return self.logical(rule.simple_expression().expr(0))

    def logical(self, rule: Any) -> Expression:
        line = rule.start.line
        if isinstance(rule, Rules.Expr_relContext):
            if rule.op.text not in _RELATIONS:
                raise self.error(rule, f"relation '{rule.op.text}'", f"{' '.join(_RELATIONS)} are supported")
            left, right = (self.operation(each) for each in rule.expr())
            return Expression(line, rule.op.text, (left, right), " ".join(_text(rule).split()))
        if isinstance(rule, Rules.Expr_andContext | Rules.Expr_orContext):
            op = "and" if isinstance(rule, Rules.Expr_andContext) else "or"
            return Expression(line, op, tuple(self.logical(each) for each in rule.expr()))
        if isinstance(rule, Rules.Expr_notContext):
            return Expression(line, "not", (self.logical(rule.expr()),))
        primary = rule.primary() if isinstance(rule, Rules.Expr_primaryContext) else None
        if isinstance(primary, Rules.Primary_output_expression_listContext):
            return self.condition(self.parenthesised(primary))
        if isinstance(primary, Rules.Primary_functionContext) and _text(primary.component_reference()) == "noEvent":
            return Expression(line, "noEvent", (self.condition(self.one_argument(primary)),))
        if isinstance(primary, Rules.Primary_trueContext | Rules.Primary_falseContext | Rules.Primary_initialContext):
            raise self.unknown(primary)
        raise self.error(rule, f"condition '{_text(rule)}'", "write relations, joined with and, or, not")

    def simple(self, rule: Any) -> Expression:
        if len(rule.expr()) != 1:
            raise self.error(rule, "range", _SCALARS)
        return self.operation(rule.expr(0))

    def operation(self, rule: Any) -> Expression:
        if isinstance(rule, Rules.Expr_signedContext):
            inner = self.operation(rule.expr())
            return Expression(rule.start.line, "neg", (inner,)) if rule.op.text == "-" else inner
        if isinstance(rule, Rules.Expr_addContext | Rules.Expr_mulContext | Rules.Expr_expContext):
            if rule.op.text.startswith("."):
                raise self.error(rule, f"operator '{rule.op.text}'", _SCALARS)
            if isinstance(rule, Rules.Expr_expContext):
                return Expression(rule.start.line, "^", tuple(self.primary(each) for each in rule.primary()))
            return Expression(rule.start.line, rule.op.text, tuple(self.operation(each) for each in rule.expr()))
        if isinstance(rule, Rules.Expr_primaryContext):
            return self.primary(rule.primary())
        raise self.unknown(rule)

    def primary(self, rule: Any) -> Expression:
        line = rule.start.line
        if isinstance(rule, Rules.Primary_unsigned_numberContext):
            return Expression(line, "number", (float(rule.getText()),))
        if isinstance(rule, Rules.Primary_component_referenceContext):
            return Expression(line, "name", (self.reference(rule.component_reference()),))
        if isinstance(rule, Rules.Primary_output_expression_listContext):
            return self.expression(self.parenthesised(rule))
        if isinstance(rule, Rules.Primary_derivativeContext):
            arguments = self.call_arguments(rule)
            if len(arguments) != 1 or arguments[0].op != "name":
                remedy = "der takes one variable, write products out as L*der(i)"
                raise self.error(rule, _text(rule), remedy)
            return Expression(line, "der", arguments[0].args)
        if isinstance(rule, Rules.Primary_functionContext):
            name = _text(rule.component_reference())
            if name == "noEvent":
                return Expression(line, name, (self.expression(self.one_argument(rule)),))
            arguments = self.call_arguments(rule)
            if name not in FUNCTIONS:
                hint = f"{', '.join(FUNCTIONS)}, noEvent are supported{nearest(name, [*FUNCTIONS, 'noEvent'])}"
                raise self.error(rule, f"function {name}()", hint)
            if len(arguments) != FUNCTIONS[name]:
                count = f"{len(arguments)} argument{'s' if len(arguments) != 1 else ''}"
                raise self.error(rule, f"{name}() with {count}", f"it takes {FUNCTIONS[name]}")
            return Expression(line, name, tuple(arguments), " ".join(_text(rule).split()))
        raise self.unknown(rule)

    def reference(self, rule: Any) -> str:
        elements = rule.component_reference_element()
        self.refuse(*(each.array_subscripts() for each in elements))
        if len(elements) != 1 or _text(rule).startswith("."):
            raise self.error(rule, f"'{_text(rule)}'", _FLAT)
        return self.identifier(elements[0])

    def parenthesised(self, rule: Any) -> Any:
        inner = rule.output_expression_list().getChildren()
        expressions = [each for each in inner if not hasattr(each, "symbol") or each.getText() == ","]
        if len(expressions) != 1:
            raise self.error(rule, f"'{_text(rule)}'", "write one expression between parentheses")
        return expressions[0]

    def call_arguments(self, rule: Any) -> list[Expression]:
        return [self.expression(each) for each in self.arguments_of(rule)]

    def one_argument(self, rule: Any) -> Any:
        arguments = self.arguments_of(rule)
        if len(arguments) != 1:
            raise self.error(rule, f"'{_text(rule)}'", "noEvent takes one expression")
        return arguments[0]

    def arguments_of(self, rule: Any) -> list[Any]:
        inner = rule.function_call_args().function_arguments()
        if inner is None:
            return []
        plain = [getattr(each, "expression", lambda: None)() for each in inner.function_argument()]
        if inner.named_arguments() or inner.for_indices() or None in plain:
            raise self.error(rule, f"'{_text(rule)}'", "give expressions as arguments")
        return plain


def _comment(rule: Any) -> str:
    """Return a description string on one line, unescaped."""
    text = "".join(token.getText()[1:-1] for token in rule.STRING())
    return " ".join(text.replace('\\"', '"').replace("\\\\", "\\").split())


def _text(rule: Any) -> str:
    if rule.stop is None or rule.stop.tokenIndex < rule.start.tokenIndex:
        return ""
    return str(rule.start.getInputStream().getText(rule.start.start, rule.stop.stop))
