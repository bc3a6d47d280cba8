;; Imports of wasm-bindgen that getrandom declares and nothing calls. A data loader is loaded without them.
(module
  (func (export "__wbindgen_describe") (param i32)))
