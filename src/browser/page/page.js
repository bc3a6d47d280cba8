"use strict";
(() => {
  const at = (id) => document.getElementById(id);
  const spoken = { reading: "Reading", sorting: "Sorting streams", estimating: "Estimating", judging: "Judging", drawing: "Drawing the report" };

  // The program, unpacked and compiled once.
  let compiled;
  const program = () => compiled ??= (async () => {
    const packed = Uint8Array.from(atob(POSEAUDIT_WASM), (letter) => letter.charCodeAt(0));
    const unpacked = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    return WebAssembly.compile(await new Response(unpacked).arrayBuffer());
  })();
  const source = URL.createObjectURL(new Blob([`(${work})()`], { type: "text/javascript" }));

  // Asks in a worker of its own, which goes with its memory. `hear` is told of each step.
  const ask = (question, files, hear) => {
    let worker, give;
    const answer = new Promise((resolve, reject) => {
      give = reject;
      program().then((module) => {
        worker = new Worker(source);
        worker.onerror = (event) => reject(new Error(event.message || "the worker does not start"));
        worker.onmessage = ({ data }) => {
          if (data.answer) resolve(data.answer);
          else if (data.failed) reject(new Error(data.failed));
          else hear?.(data);
        };
        worker.postMessage({ module, question, files });
      }).catch((error) => reject(new Error(`WebAssembly does not start: ${error.message}`)));
    }).finally(() => worker?.terminate());
    return { answer, stop: () => give(new Error("stopped")) };
  };

  // A link that saves `text`, in the place of what it saved before.
  const saves = (link, text, type, name) => {
    if (link.href) URL.revokeObjectURL(link.href);
    link.href = URL.createObjectURL(new Blob([text], { type }));
    link.download = name;
  };
  const say = (place, text, isError = false) => {
    place.textContent = text;
    place.classList.toggle("error", isError);
  };
  const filled = (id) => at(id).value.trim() || null;

  // Tabs, as a keyboard expects them.
  const tabs = [...document.querySelectorAll("[role=tab]")];
  const open = (tab) => tabs.forEach((other) => {
    other.ariaSelected = String(other === tab);
    other.tabIndex = other === tab ? 0 : -1;
    at(other.getAttribute("aria-controls")).hidden = other !== tab;
  });
  tabs.forEach((tab, place) => {
    tab.onclick = () => open(tab);
    tab.onkeydown = ({ key }) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[key];
      if (!step) return;
      const next = tabs[(place + step + tabs.length) % tabs.length];
      open(next);
      next.focus();
    };
  });

  // The files of an audit.
  let chosen = [];
  const kind = ({ name }) => /(^|\/)poseaudit\.toml$/i.test(name) ? "config" : /\.(urdf|xml|toml)$/i.test(name) ? "robot" : "log";
  const show = () => {
    at("chosen").replaceChildren(...chosen.map((file, place) => {
      const row = document.createElement("li");
      const size = file.size < 1e6 ? `${(file.size / 1e3).toFixed(1)} kB` : `${(file.size / 1e6).toFixed(1)} MB`;
      row.textContent = `${file.name} (${kind(file)}, ${size})`;
      const drop = document.createElement("button");
      drop.type = "button";
      drop.textContent = "×";
      drop.ariaLabel = `Leave out ${file.name}`;
      drop.onclick = () => { chosen.splice(place, 1); show(); };
      row.append(drop);
      return row;
    }));
    at("start").disabled = running !== null || !chosen.some((file) => kind(file) === "log");
  };
  let running = null;
  const take = (files) => {
    const names = new Set([...files].map((file) => file.name));
    chosen = [...chosen.filter((file) => !names.has(file.name)), ...files];
    show();
  };
  at("files").onchange = ({ target }) => { take(target.files); target.value = ""; };
  at("clear").onclick = () => { chosen = []; say(at("said"), ""); show(); at("files").focus(); };
  addEventListener("dragover", (event) => { event.preventDefault(); document.body.classList.add("over"); });
  addEventListener("dragleave", (event) => { if (!event.relatedTarget) document.body.classList.remove("over"); });
  addEventListener("drop", (event) => {
    event.preventDefault();
    document.body.classList.remove("over");
    if (event.dataTransfer.files.length === 0 || running) return;
    open(tabs[0]);
    // A log that is dropped alone is audited at once.
    const isFirst = chosen.length === 0;
    take(event.dataTransfer.files);
    if (isFirst && !at("start").disabled) at("ask").requestSubmit();
  });

  at("ask").onsubmit = async (event) => {
    event.preventDefault();
    if (running || at("start").disabled) return;
    const files = chosen.map((file) => ({ name: file.name, as: kind(file) }));
    const began = performance.now();
    say(at("said"), "");
    delete at("said").dataset.status;
    at("result").hidden = true;
    at("course").hidden = false;
    at("doing").textContent = "Starting";
    at("bar").removeAttribute("value");
    running = ask({ audit: { files, robot: filled("robot") } }, chosen, ({ doing, read, total }) => {
      const share = total > 0 ? read / total : 0;
      const isReading = doing === "reading";
      at("doing").textContent = isReading ? `Reading, ${Math.floor(100 * share)} %` : spoken[doing] ?? doing;
      if (isReading) at("bar").value = share;
      else at("bar").removeAttribute("value");
    });
    show();
    try {
      const { error, json, shown, status } = await running.answer;
      const took = ((performance.now() - began) / 1000).toFixed(1);
      const name = files.find((file) => file.as === "log").name;
      if (error) say(at("said"), `error: ${error}`, true);
      else say(at("said"), `Audited in ${took} s.`);
      at("said").dataset.status = status;
      saves(at("save-html"), shown, "text/html", `${name}.html`);
      saves(at("save-json"), json, "application/json", `${name}.json`);
      at("report").srcdoc = shown;
      at("result").hidden = false;
    } catch (error) {
      say(at("said"), error.message === "stopped" ? "Stopped." : `error: ${error.message}`, error.message !== "stopped");
    } finally {
      running = null;
      at("course").hidden = true;
      show();
    }
  };
  at("stop").onclick = () => running?.stop();

  at("poses").onsubmit = async (event) => {
    event.preventDefault();
    at("tell").disabled = true;
    say(at("desk-said"), "");
    const desk = {
      pose: at("pose-a").value, coded: filled("coded-a"), other: filled("pose-b"), other_coded: filled("coded-b"),
      robot: filled("desk-robot"),
    };
    try {
      const { error, json, shown } = await ask({ desk }, []).answer;
      at("told").hidden = at("desk-save").hidden = Boolean(error);
      if (error) {
        say(at("desk-said"), `error: ${error}`, true);
      } else {
        at("told").textContent = shown;
        saves(at("save-pose"), json, "application/json", "pose.json");
      }
    } catch (error) {
      say(at("desk-said"), `error: ${error.message}`, true);
    } finally {
      at("tell").disabled = false;
    }
  };
  show();
})();
