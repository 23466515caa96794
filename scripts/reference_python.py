"""Writes the reference of the Python package from its docstrings, without importing it."""
import ast
import inspect
import pathlib
import re

ROOT = pathlib.Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "python" / "package" / "atomesh"
PAGE = "python-api.md"
HEAD = """# Python functions and classes

<!-- Written by scripts/reference.py from the docstrings of the package: `make figures`. -->

The package's tests run all examples of this page. [Python](python.md) has the forms that volumes and options can have, and
[Python in ten minutes](../tutorials/python.md) is a first start. `**options` are those of the [command line](options.md), with underscores;
`atomesh.options("mesh")` lists them.

"""
SECTIONS = ["Parameters", "Attributes", "Returns", "Warns", "Raises", "See Also", "Examples"]


def trees():
    """Returns the parsed modules of the package by their names."""
    return {path.stem: ast.parse(path.read_text(encoding="utf-8")) for path in sorted(PACKAGE.glob("*.py"))}


def public_names(module):
    """Returns the names in `__all__`."""
    for node in module.body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
            return ast.literal_eval(node.value)
    raise SystemExit("error: python/package/atomesh/__init__.py: has no __all__")


def definitions(modules):
    """Returns the functions and classes of the package by their names."""
    nodes = [node for tree in modules.values() for node in tree.body]
    return {node.name: node for node in nodes if isinstance(node, (ast.FunctionDef, ast.ClassDef))}


def decorators(node):
    return {getattr(decorator, "id", "") for decorator in node.decorator_list}


def public_methods(node):
    """Returns the public methods and properties of a class, and `__getitem__` and `__call__` if they are described."""
    methods = [item for item in node.body if isinstance(item, ast.FunctionDef) and "overload" not in decorators(item)]
    described = {"__getitem__", "__call__"}
    return [item for item in methods if not item.name.startswith("_") or item.name in described and ast.get_docstring(item)]


def parameters(node):
    """Returns the names of a function's parameters, with their stars."""
    arguments = node.args
    names = [argument.arg for argument in arguments.posonlyargs + arguments.args + arguments.kwonlyargs]
    names += [f"*{arguments.vararg.arg}"] if arguments.vararg else []
    names += [f"**{arguments.kwarg.arg}"] if arguments.kwarg else []
    return [name for name in names if name not in ("self", "cls")]


def call(node):
    """Returns the call of a function as it is typed: without types, with defaults."""
    arguments, texts = node.args, []
    positional = arguments.posonlyargs + arguments.args
    defaults = [None] * (len(positional) - len(arguments.defaults)) + arguments.defaults
    shown = lambda name, default: name if default is None else f"{name}={ast.unparse(default)}"
    texts += [shown(a.arg, default) for a, default in zip(positional, defaults) if a.arg not in ("self", "cls")]
    if arguments.kwonlyargs:
        texts.append("*")
    texts += [shown(a.arg, default) for a, default in zip(arguments.kwonlyargs, arguments.kw_defaults)]
    texts += [f"**{arguments.kwarg.arg}"] if arguments.kwarg else []
    return f"({', '.join(texts)})"


def sections(docstring):
    """Returns the sections of a docstring in NumPy's style by their titles; the text before them is called ''."""
    found, title, lines = {}, "", inspect.cleandoc(docstring).split("\n")
    for at, line in enumerate(lines):
        if at + 1 < len(lines) and line in SECTIONS and re.fullmatch("-{3,}", lines[at + 1]):
            title = line
        elif not (re.fullmatch("-{3,}", line) and lines[at - 1] == title):
            found.setdefault(title, []).append(line)
    return {title: "\n".join(lines).strip("\n") for title, lines in found.items()}


def entries(text):
    """Yields the names of a section and their descriptions."""
    for entry in re.split(r"\n(?=\S)", text):
        name, _, description = entry.partition("\n")
        yield name, " ".join(description.split())


def escaped(text):
    return re.sub(r"(\*+)(?=options)", lambda stars: "\\*" * len(stars[0]), text)


def markdown(docstring):
    """Returns a docstring in NumPy's style as Markdown."""
    lines = []
    for title, text in sections(docstring).items():
        if title == "":
            # An indented block is code.
            blocks = text.split("\n\n")
            lines += [f"```python\n{inspect.cleandoc(b)}\n```\n" if b.startswith("    ") else b + "\n" for b in blocks]
        elif title == "Examples":
            lines.append(f"```python\n{text}\n```\n")
        elif title == "See Also":
            lines += [f"See also: {text.replace(' : ', ', ', 1)}\n"]
        else:
            lines.append(f"**{title}**\n")
            for name, description in entries(text):
                name, _, kind = name.partition(" : ")
                kind = f" ({kind})" if kind else ""
                lines.append(f"- `{name}`{kind}: {escaped(description)}")
            lines.append("")
    return "\n".join(lines)


def undocumented(place, node):
    """Yields what the docstring of a function or class misses."""
    docstring = ast.get_docstring(node)
    if not docstring:
        yield f"{place} has no docstring"
        return
    if isinstance(node, ast.ClassDef) or "property" in decorators(node):
        return
    found = sections(docstring)
    described = {name.partition(" : ")[0] for name, _ in entries(found.get("Parameters", ""))}
    for name in parameters(node):
        if name not in described:
            yield f"the docstring of {place} does not describe the parameter {name}"
    if ast.unparse(node.returns) != "None" and "Returns" not in found:
        yield f"the docstring of {place} has no section Returns"


def names_of(modules):
    """Yields the names on the page, with their definitions: functions, classes, and after them the errors."""
    known = definitions(modules)
    errors = {node.name for node in modules["_errors"].body if isinstance(node, ast.ClassDef)}
    names = [name for name in public_names(modules["__init__"]) if name in known and name not in errors]
    yield from ((name, known[name]) for name in sorted(names, key=lambda name: isinstance(known[name], ast.ClassDef)))
    yield from ((node.name, node) for node in modules["_errors"].body if isinstance(node, ast.ClassDef))


def missing():
    """Yields a line for each public function, class and method that is not described completely."""
    for name, node in names_of(trees()):
        yield from undocumented(f"atomesh.{name}", node)
        if isinstance(node, ast.ClassDef):
            for method in public_methods(node):
                yield from undocumented(f"atomesh.{name}.{method.name}", method)


def page():
    """Returns the page."""
    lines, is_function = ["## Functions", ""], True
    modules = trees()
    errors = {node.name for node in modules["_errors"].body if isinstance(node, ast.ClassDef)}
    for name, node in names_of(modules):
        if is_function and isinstance(node, ast.ClassDef):
            is_function = False
            lines += ["## Classes", ""]
        if name in errors and "## Errors" not in lines:
            lines += ["## Errors", "", markdown(ast.get_docstring(modules["_errors"])), ""]
        if not is_function:
            bases = ", ".join(f"`{ast.unparse(base)}`" for base in node.bases) if name in errors else ""
            lines += [f"### {name}", "", *([f"A subclass of {bases}.", ""] if bases else [])]
            lines.append(markdown(ast.get_docstring(node)))
            for method in public_methods(node):
                kind = "" if "property" in decorators(method) else call(method)
                title = f"{name}.{method.name}{kind}"
                title = title.replace(".__getitem__(cells)", "[cells]").replace(".__call__", "")
                lines += [f"#### `{title}`", "", markdown(ast.get_docstring(method))]
        else:
            lines += [f"### `{name}{call(node)}`", "", markdown(ast.get_docstring(node))]
    return HEAD + re.sub(r"\n{3,}", "\n\n", "\n".join(lines)).strip() + "\n"
