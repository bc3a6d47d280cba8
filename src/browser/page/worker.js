"use strict";
// The work, beside the page: `{ module, question, files }` in, `{ doing, read, total }` now and then, one
// `{ answer }` or `{ failed }` out. The page starts it from this function's text, so that it runs from a disk, too.
function work() {
  onmessage = async ({ data: { module, question, files } }) => {
    let memory;
    let said = "";
    const text = (at, length) => new TextDecoder().decode(new Uint8Array(memory.buffer, at, length));
    const steps = {
      step: (at, length, read, total) => postMessage({ doing: text(at, length), read, total }),
      failed: (at, length) => { said = text(at, length); },
    };
    // What a library asks of a page and nobody calls.
    const nothing = () => { throw new Error("a page has no such function"); };
    const imports = {};
    for (const { module: from, name } of WebAssembly.Module.imports(module)) {
      (imports[from] ??= {})[name] = steps[name] ?? nothing;
    }
    try {
      const { exports } = await WebAssembly.instantiate(module, imports);
      memory = exports.memory;
      const placed = (bytes) => {
        const at = exports.room(bytes.length) >>> 0;
        if (at === 0) throw new RangeError(`${bytes.length} bytes`);
        new Uint8Array(memory.buffer, at, bytes.length).set(bytes);
        return [at, bytes.length];
      };
      for (const file of files) {
        exports.file(...placed(new Uint8Array(await file.arrayBuffer())));
      }
      const at = exports.ask(...placed(new TextEncoder().encode(JSON.stringify(question)))) >>> 0;
      const length = new DataView(memory.buffer).getUint32(at, true);
      postMessage({ answer: JSON.parse(text(at + 4, length)) });
    } catch (error) {
      const full = error instanceof RangeError || /memory allocation/.test(said) ||
        (memory && memory.buffer.byteLength > 3.9e9);
      const unread = error instanceof DOMException;
      postMessage({
        failed: unread ? `a file cannot be read: ${error.message}` :
          full ? "out of memory: a page has 4 GB at most; audit the log with the program" :
          `poseaudit failed: ${said.split("\n").join(" ") || error.message}; please report it with the log, or use the program`,
      });
    }
  };
}
