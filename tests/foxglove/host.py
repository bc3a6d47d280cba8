"""Hosts Foxglove data loaders outside the app.

The app loads the core module and calls it by the canonical ABI of `foxglove:loader@0.1.0` (loader.wit of the crate
foxglove_data_loader), with files as readers that write into the module's memory. So does this host, on wasmtime.
"""

from __future__ import annotations

import base64
import ctypes
import json
import re
import struct
import zipfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

from wasmtime import Engine, Func, FuncType, Instance, Linker, Memory, Module, Store, ValType

LOADER, READER, CONSOLE = (f"foxglove:loader/{name}@0.1.0" for name in ("loader", "reader", "console"))
I32, I64 = ValType.i32, ValType.i64
MASK = 0xFFFF_FFFF  # wasmtime passes addresses as signed numbers


class LoaderError(Exception):
    """The loader returned an error."""


@dataclass(frozen=True)
class Type:
    """A type of the interface: size and alignment in memory, and how to read a value."""

    size: int
    align: int
    lift: Callable[[ctypes.Array, int], object]


def aligned(offset: int, align: int) -> int:
    return -(-offset // align) * align


def number(code: str) -> Type:
    size = struct.calcsize(code)
    return Type(size, size, lambda memory, at: struct.unpack_from(code, memory, at)[0])


def enum(*names: str) -> Type:
    return Type(1, 1, lambda memory, at: names[memory[at]])


def lift_bytes(memory: ctypes.Array, at: int) -> bytes:
    start, length = struct.unpack_from("<II", memory, at)
    return ctypes.string_at(ctypes.addressof(memory) + start, length)


def list_of(item: Type) -> Type:
    def lift(memory: ctypes.Array, at: int) -> list:
        start, length = struct.unpack_from("<II", memory, at)
        return [item.lift(memory, start + index * item.size) for index in range(length)]

    return Type(8, 4, lift)


def record(**fields: Type) -> Type:
    offsets, end = {}, 0
    for name, field in fields.items():
        offsets[name] = aligned(end, field.align)
        end = offsets[name] + field.size
    align = max(field.align for field in fields.values())

    def lift(memory: ctypes.Array, at: int) -> SimpleNamespace:
        return SimpleNamespace(**{name: field.lift(memory, at + offsets[name]) for name, field in fields.items()})

    return Type(aligned(end, align), align, lift)


def variant(*cases: Type | None, wrap: Callable[[int, object], object]) -> Type:
    known = [case for case in cases if case]
    align = max(case.align for case in known)
    offset = aligned(1, align)

    def lift(memory: ctypes.Array, at: int) -> object:
        case = cases[memory[at]]
        return wrap(memory[at], case.lift(memory, at + offset) if case else None)

    return Type(aligned(offset + max(case.size for case in known), align), align, lift)


def option(some: Type) -> Type:
    return variant(None, some, wrap=lambda _, value: value)


def result(ok: Type) -> Type:
    def wrap(case: int, value: object) -> object:
        if case == 1:
            raise LoaderError(value)
        return value

    return variant(ok, STRING, wrap=wrap)


U16, U32, U64 = number("<H"), number("<I"), number("<Q")
BYTES = Type(8, 4, lift_bytes)
STRING = Type(8, 4, lambda memory, at: lift_bytes(memory, at).decode("utf-8"))
CHANNEL = record(
    id=U16, schema_id=option(U16), topic_name=STRING, message_encoding=STRING, message_count=option(U64)
)
SCHEMA = record(id=U16, name=STRING, encoding=STRING, data=BYTES)
PROBLEM = record(severity=enum("info", "warning", "error"), message=STRING, tip=option(STRING))
INITIALIZATION = record(
    channels=list_of(CHANNEL),
    schemas=list_of(SCHEMA),
    time_range=record(start_time=U64, end_time=U64),
    problems=list_of(PROBLEM),
)
MESSAGE = record(channel_id=U16, log_time=U64, publish_time=U64, data=BYTES)


class Loader:
    """A data loader with the given files open. Text that it logs is in `console`."""

    def __init__(self, engine: Engine, module: Module, files: Iterable[Path]) -> None:
        files = list(files)
        self.store = Store(engine)
        self.console: list[tuple[str, str]] = []
        self.files = {str(file): file.read_bytes() for file in files}
        self.readers: list[list] = []  # content and position
        self.handles: list[int] = [0]  # of the loader's own objects; 0 is no handle
        linker = Linker(engine)
        self.define_imports(linker)
        instance: Instance = linker.instantiate(self.store, module)
        self.exports = instance.exports(self.store)
        self.memory: Memory = self.exports["memory"]
        paths = [self.lower(path.encode()) for path in self.files]
        table = self.lower(b"".join(struct.pack("<II", *path) for path in paths), count=len(paths), align=4)
        handle = self.call("[constructor]data-loader", *table)
        self.loader = self.handles[handle]

    def define_imports(self, linker: Linker) -> None:
        def define(module: str, name: str, kinds: list, results: list, function: Callable) -> None:
            kinds, results = [kind() for kind in kinds], [kind() for kind in results]
            linker.define(self.store, module, name, Func(self.store, FuncType(kinds, results), function))

        def text(start: int, length: int) -> str:
            start &= MASK
            return bytes(self.memory.read(self.store, start, start + length)).decode("utf-8")

        def opened(start: int, length: int) -> int:
            self.readers.append([self.files[text(start, length)], 0])
            return len(self.readers) - 1

        def seek(reader: int, position: int) -> int:
            self.readers[reader][1] = position
            return position

        def read(reader: int, start: int, length: int) -> int:
            content, position = self.readers[reader]
            part = content[position : position + (length & MASK)]
            self.memory.write(self.store, part, start & MASK)
            self.readers[reader][1] += len(part)
            return len(part)

        def new(rep: int) -> int:
            self.handles.append(rep)
            return len(self.handles) - 1

        for level in ("log", "warn", "error"):
            log = lambda start, length, level=level: self.console.append((level, text(start, length)))  # noqa: E731
            define(CONSOLE, level, [I32, I32], [], log)
        define(READER, "open", [I32, I32], [I32], opened)
        define(READER, "[method]reader.seek", [I32, I64], [I64], seek)
        define(READER, "[method]reader.position", [I32], [I64], lambda reader: self.readers[reader][1])
        define(READER, "[method]reader.read", [I32, I32, I32], [I64], read)
        define(READER, "[method]reader.size", [I32], [I64], lambda reader: len(self.readers[reader][0]))
        define(READER, "[resource-drop]reader", [I32], [], lambda _: None)
        for resource in ("data-loader", "message-iterator"):
            own = f"[export]{LOADER}"
            define(own, f"[resource-new]{resource}", [I32], [I32], new)
            define(own, f"[resource-rep]{resource}", [I32], [I32], lambda handle: self.handles[handle])
            define(own, f"[resource-drop]{resource}", [I32], [], lambda _: None)

    def call(self, name: str, *arguments: int) -> int:
        return self.exports[f"{LOADER}#{name}"](self.store, *arguments)

    def lower(self, content: bytes, count: int | None = None, align: int = 1) -> tuple[int, int]:
        """Writes a list into the memory: its address and length."""
        at = self.exports["cabi_realloc"](self.store, 0, 0, align, len(content)) if content else align
        self.memory.write(self.store, content, at & MASK)
        return at, len(content) if count is None else count

    def lifted(self, kind: Type, name: str, *arguments: int) -> object:
        """Calls a method, reads its result and frees it."""
        at = self.call(name, *arguments)
        try:
            return kind.lift(self.memory.get_buffer_ptr(self.store), at & MASK)
        finally:
            self.exports[f"cabi_post_{LOADER}#{name}"](self.store, at)

    def initialize(self) -> SimpleNamespace:
        return self.lifted(result(INITIALIZATION), "[method]data-loader.initialize", self.loader)

    def messages(
        self, channels: list[int], start: int | None = None, end: int | None = None
    ) -> Iterator[SimpleNamespace]:
        times = [part for time in (start, end) for part in (int(time is not None), time or 0)]
        ids = self.lower(struct.pack(f"<{len(channels)}H", *channels), count=len(channels), align=2)
        name = "[method]data-loader.create-iterator"
        handle = self.lifted(result(U32), name, self.loader, *times, *ids)
        iterator = self.handles[handle]
        while message := self.lifted(option(result(MESSAGE)), "[method]message-iterator.next", iterator):
            yield message

    def backfill(self, channels: list[int], time: int) -> list[SimpleNamespace]:
        ids = self.lower(struct.pack(f"<{len(channels)}H", *channels), count=len(channels), align=2)
        name = "[method]data-loader.get-backfill"
        return self.lifted(result(list_of(MESSAGE)), name, self.loader, time, *ids)


class Extension:
    """An extension file: its manifest, the file types that it registers, and the module."""

    def __init__(self, path: Path) -> None:
        with zipfile.ZipFile(path) as archive:
            self.names = archive.namelist()
            self.manifest = json.loads(archive.read("package.json"))
            self.script = archive.read(self.manifest["main"].removeprefix("./")).decode("utf-8")
        data = re.search(r'"data:application/wasm;base64,([^"]*)"', self.script)
        self.wasm = base64.b64decode(data[1])
        self.engine = Engine()
        self.module = Module(self.engine, self.wasm)

    def open(self, *files: Path) -> Loader:
        return Loader(self.engine, self.module, files)
