"use strict";

// `.ci/foxe.py` inserts the module.
const wasmUrl = "data:application/wasm;base64,POSEAUDIT_WASM";

// Types that Foxglove does not open. `.json` is the type of its layouts.
const fileTypes = [
  ".csv", ".tsv", ".txt", ".dat", ".tum", ".xlsx", ".jsonl", ".ndjson", ".yaml", ".yml", ".xml",
  ".npy", ".npz", ".parquet", ".h5", ".hdf5", ".mat", ".tfrecord",
];

module.exports = {
  activate(context) {
    for (const supportedFileType of fileTypes) {
      context.registerDataLoader({ type: "file", wasmUrl, supportedFileType, supportsMultiFile: true });
    }
  },
};
