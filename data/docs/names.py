"""Reference of the public names: a section a name, from signatures and docstrings."""

import dataclasses
import inspect
import json
import re
from collections.abc import Callable, Iterator

import wrenchbook
from data.docs.calls import openapi
from data.docs.markdown import check_groups, table

SECTIONS = {
    "Client": ("Client", "AsyncClient"),
    "Answers": ("Displacement", "Displacements", "DeformedShape", "Stress"),
    "Tables": ("Table",),
    "Joints": (
        *("Joint", "MujocoJoint", "step_joints", "pull_joints", "joints_in_mj_step"),
        *("JointReport", "Joints", "MujocoJoints", "LinearPart"),
    ),
    "Mounts": ("Mount", "MujocoMount", "Settled"),
    "Conventions": ("conventions",),
    "Arrays of JAX and PyTorch": ("arrays",),
    "Figures": ("plot",),
    "Scenes": ("Scene", "ComponentPlan"),
    "Jobs and events": ("Job", "Round", "Event"),
    "Recordings": ("Recorder", "Recording", "Envelope", "Started"),
    "Errors": (
        *("WrenchbookError", "InvalidArgument", "MissingPackage", "ProblemError", "RecorderError"),
        *("SceneError", "ServerTimeout", "ServerUnreachable", "TableError", "MountError"),
        *("SensorError", "DisplacementUnknown", "CouplingDiverged", "MountWarning", "JointError"),
        *("JointRangeError", "JointWarning"),
    ),
}
"""The public names by their use, in the order of the page."""
MADE_BY_CALLS = (
    *SECTIONS["Answers"],
    *("Table", "JointReport", "LinearPart", "Settled", "ComponentPlan", "Job", "Round", "Event"),
    *("Recording", "Envelope", "Started"),
)
"""The classes whose objects a call returns: their constructors are no part of the reference."""
CLASS_METHODS = ("Table.open", "Scene.read")  # the others read replies of the server
INTERNAL = (
    *("Client.send_block", "AsyncClient.send_block"),
    *(
        f"{kind}.{call}"
        for kind in ("Joint", "MujocoJoint")
        for call in ("new_steps", "warn_beyond", "warn_uncovered", "weakest")
    ),
    *("MujocoJoint.attach", "MujocoJoint.lose_wrench", "MujocoJoint.read_scene"),
    *("Scene.component", "Scene.query"),
)
"""Public members that other modules of the client call, and no program."""
OF_MODULE = {
    "arrays": ("jax", "torch", "jax_joint"),
    "conventions": (
        *("from_mujoco", "to_mujoco", "from_drake", "to_drake", "from_pybullet", "to_pybullet"),
        *("from_ros", "to_ros", "moved", "quaternion_wxyz", "quaternion_xyzw"),
    ),
    "plot": ("response", "coverage", "deformed"),
}
CALL = wrenchbook.Client
DONORS = {
    "Client.call_json": (CALL.call,),
    "Client": (CALL.displacement, CALL.start_recording, CALL.wait, CALL.invalidate_row),
    "Table": (CALL.displacement,),
    "Recorder": (CALL.start_recording,),
    "Joints": (wrenchbook.Joint,),
    "Joints.step": (wrenchbook.Joint.step,),
    "MujocoJoints": (wrenchbook.MujocoJoint, wrenchbook.Joint),
    "MujocoMount": (wrenchbook.Mount.place, wrenchbook.Mount.settle),
    "arrays": (wrenchbook.arrays.jax, wrenchbook.Joint),
    "conventions": (wrenchbook.conventions.from_mujoco,),
    "plot": (wrenchbook.plot,),
}
"""The docstrings that describe further parameters of a call, by the call or its class."""
USUAL = {
    "Client.job.wait_s": ("float, optional", "Longest wait for the end of the job, s."),
    "Client.call_json.method": ("str", "Method of the request, such as `GET`."),
    "Recorder.add.wrench": ("array_like", "Shape (inputs,), N and N·m."),
    "Client.import_table.format": ("str, optional", "Format; by default from name and content."),
    "body": ("object", "What is sent, as JSON."),
    "client": ("Client", "A client of the server that has the components."),
    "component": ("str, optional", "Name of the component; needed with a client."),
    "decimal": ("{'.', ','}, optional", "Decimal mark of numbers in text."),
    "format": ("str", "One of the formats above."),
    "headers": ("mapping, optional", "Further headers of the request."),
    "joints": ("MujocoJoint", "The joints of one scene."),
    "kind": ("str, optional", "Content type of `content`."),
    "name": ("str", "Name of the component."),
    "options": ("", "Options of the call that is named above."),
    "path": ("path", "Path of the file."),
    "rotation": ("array_like", "Rotation vector, shape (3,), rad."),
    "timeout_s": ("float", "Longest wait, s."),
    "which": ("array_like, optional", "Mask or indices of joints."),
    "wrench": ("array_like", "Force then moment, shape (6,), N and N·m."),
    "wrenches": ("array_like", "Shape (n, inputs), N and N·m."),
}
"""Type and meaning of parameters that no docstring has, by their name alone or in a call."""
OUTCOMES = ("Returns", "Yields", "Raises", "Warns")
"""Sections of a docstring about what comes of a call."""


def names() -> list[str]:
    """Return a heading for each group, and a section for each public name and each call of it."""
    check_groups("name", SECTIONS, {name for name in wrenchbook.__all__ if name != "__version__"})
    lines = []
    for heading, group in SECTIONS.items():
        lines += [f"## {heading}", ""]
        if heading == "Errors":
            rows = [(f"`{name}`", _purpose(getattr(wrenchbook, name))) for name in group]
            lines += table(("name", "meaning"), rows)
            for name in group:
                if fields := described(getattr(wrenchbook, name), "Parameters"):
                    cells = [(f"`{words}`", text) for words, _, text in fields]
                    lines += [f"### {name}", "", *table(("attribute", "meaning"), cells)]
            continue
        for name in group:
            lines += _section(name, getattr(wrenchbook, name))
    return lines


def _section(name: str, value: object) -> list[str]:
    """Return the section of a public name: its constructor, attributes and calls."""
    if name not in OF_MODULE and not inspect.isclass(value):
        return [f"### {name}", "", *_call(name, value)]
    lines = [f"### {name}", ""]
    if name in OF_MODULE or name in MADE_BY_CALLS or name == "AsyncClient":
        lines += [_purpose(value), "", *_remarks(value)]
    else:
        lines += _call(name, value)
    if name == "AsyncClient":
        return lines
    if inspect.isclass(value):
        rows = [*_attributes(name, value)]
        lines += table(("attribute", "meaning"), rows)
    for call, member in _members(name, value):
        lines += [f"#### {call}", "", *_call(call, member)]
    return lines


def _members(name: str, value: object) -> list[tuple[str, Callable]]:
    """Return the calls of a module or class; of a subclass those that it defines itself."""
    if name in OF_MODULE:
        return [(f"{name}.{call}", getattr(value, call)) for call in OF_MODULE[name]]
    base = _base(value)
    return [
        (f"{name}.{key}", member)
        for key, member in inspect.getmembers(value)
        if f"{name}.{key}" in CLASS_METHODS
        or (inspect.isfunction(member) and f"{name}.{key}" not in INTERNAL)
        if not key.startswith("_")
        if base is None or getattr(base, key, None) is not member
    ]


def _base(value: object) -> type | None:
    """Return the public class that a class extends."""
    public = [getattr(wrenchbook, name) for name in wrenchbook.__all__]
    return next((base for base in getattr(value, "__mro__", ())[1:] if base in public), None)


def _call(name: str, value: Callable) -> list[str]:
    """Return signature, purpose, parameters and outcomes of a call."""
    base = _base(value) if inspect.isclass(value) else None
    return [
        *("```text", _signature(name, value), "```", ""),
        *(_purpose(value), "", *_remarks(value)),
        *_parameters(name, value),
        *_outcomes(value),
        *([f"Other attributes and calls are those of `{base.__name__}`.", ""] if base else []),
    ]


def _signature(name: str, value: Callable) -> str:
    """Return a call with its defaults and its result, without the types of arguments."""
    signature = inspect.signature(value)
    plain = [
        argument.replace(annotation=argument.empty)
        for argument in signature.parameters.values()
        if argument.name != "self"
    ]
    result = "" if inspect.isclass(value) else str(signature.return_annotation).strip("'")
    arguments = str(signature.replace(parameters=plain, return_annotation=signature.empty))
    return f"{name}{arguments}" + (f" -> {result}" if result not in ("", "None") else "")


def _purpose(value: object) -> str:
    """Return the first line of a docstring, a result by its noun."""
    text = _plain(inspect.cleandoc(value.__doc__ or "").partition("\n")[0])
    noun = re.match(r"Return ([a-z])(?=\w* )", text)
    return f"{noun[1].upper()}{text[noun.end() :]}" if noun else text.removeprefix("Return ")


def _plain(text: str) -> str:
    return text.replace("``", "`").replace("\n", " ")


def _remarks(value: object) -> list[str]:
    """Return the paragraphs of a docstring between its first line and its sections, and Notes."""
    text = inspect.cleandoc(value.__doc__ or "")
    between = re.split(r"\n\n(?:\w+\n-+\n)", text)[0].partition("\n\n")[2]
    notes = text.partition("\nNotes\n-----\n")[2].partition("\n\n")[0]
    paragraphs = [part for part in (*between.split("\n\n"), notes) if part]
    return [line for part in paragraphs for line in (part.replace("``", "`"), "")]


def described(value: object, section: str) -> list[tuple[str, str, str]]:
    """Return the names, types and texts of a section of a docstring."""
    text = inspect.cleandoc(value.__doc__ or "").partition(f"\n{section}\n")[2]
    text = re.split(r"\n\n", text)[0].replace("``", "`")  # the next section follows an empty line
    entry = r"^(\*{0,2}\w[\w, ]*?)(?: : (.*))?$((?:\n    .*)*)"
    return re.findall(entry, text, re.M)


def _parameters(name: str, value: Callable) -> list[str]:
    """Return the table of a call's parameters; raise ValueError for one without a meaning."""
    explained = described(value, "Parameters")
    named = {word.lstrip("*") for words, _, _ in explained for word in words.split(", ")}
    order = [argument for argument in inspect.signature(value).parameters if argument != "self"]
    further: dict[tuple[str, str], list[str]] = {}
    for argument in order:
        if argument not in named:
            for meaning in _further(name, argument, value):
                further.setdefault(meaning, []).append(argument)
    rows = [(words.split(", "), kind, text) for words, kind, text in explained]
    rows += [(words, *meaning) for meaning, words in further.items()]
    rows.sort(key=lambda row: order.index(row[0][0].lstrip("*")))
    cells = [(", ".join(f"`{word}`" for word in words), *meaning) for words, *meaning in rows]
    return table(("parameter", "type", "meaning"), cells)


def _further(call: str, argument: str, value: object) -> Iterator[tuple[str, str]]:
    """Yield type and meaning of a parameter that the docstring of its call does not list.

    A parameter that the text of the docstring explains has none.
    """
    usual = USUAL.get(f"{call}.{argument}")
    donors = DONORS.get(call) or DONORS.get(call.partition(".")[0], ())
    rows = (row for donor in donors for row in described(donor, "Parameters"))
    donated = next(
        ((kind, text) for words, kind, text in rows if argument in words.split(", ")), None
    )
    if meaning := usual or donated:
        yield meaning
    elif f"`{argument}`" not in (value.__doc__ or ""):
        if argument not in USUAL:
            raise ValueError(f"no docstring describes the parameter {argument} of {call}")
        yield USUAL[argument]


def _outcomes(value: object) -> list[str]:
    """Return the results, errors and warnings that a docstring describes, a line each."""
    lines = []
    for section in OUTCOMES:
        text = inspect.cleandoc(value.__doc__ or "").partition(f"\n{section}\n-")[2]
        body = re.split(r"\n\n", text.partition("\n")[2])[0]
        for kind, meaning in re.findall(r"^(\S.*)$((?:\n    .*)*)", body, re.M):
            words = " ".join(_plain(meaning).split())
            condition = re.sub("^If ", "if ", words)
            link = " " if condition != words else ": "
            lines.append(f"- {section} `{kind}`{link}{condition}".rstrip(": "))
    return [*lines, ""] if lines else []


def _attributes(name: str, value: type) -> Iterator[tuple[str, str]]:
    """Yield the attributes that a class' docstring describes, then its other properties.

    Fields of a reply without such a description have that of the OpenAPI document.
    """
    rows = described(value, "Attributes")
    if not rows and dataclasses.is_dataclass(value):
        rows = described(value, "Parameters") if name in MADE_BY_CALLS else []
    named = {word for words, _, _ in rows for word in words.split(", ")}
    for words, _, text in rows:
        yield ", ".join(f"`{word}`" for word in words.split(", ")), text
    if not rows and dataclasses.is_dataclass(value) and name in MADE_BY_CALLS:
        for field in dataclasses.fields(value):
            yield f"`{field.name}`", _field_text(value, field.name)
    base = _base(value)
    for word, member in inspect.getmembers(value, lambda member: isinstance(member, property)):
        inherited = base is not None and getattr(base, word, None) is member
        if not (word in named or word.startswith("_") or inherited):
            yield f"`{word}`", _purpose(member)


def _field_text(value: type, field: str) -> str:
    """Return the description of a reply's field, by the schema of the class or of its base."""
    schemas = openapi()["components"]["schemas"]
    schema = next(schemas[base.__name__] for base in value.__mro__ if base.__name__ in schemas)
    text = schema["properties"].get(field, {"description": "name of the component"})["description"]
    for json_word in ("null", "true", "false"):
        text = re.sub(rf"\b{json_word}\b", repr(json.loads(json_word)), text)
    return f"{text[0].upper()}{text[1:]}."
