;; As placeholder.wat: wasm-bindgen's table of JavaScript objects, which stays empty.
(module
  (func (export "__wbindgen_externref_statics_end") (result i32) (i32.const 0))
  (func (export "__wbindgen_externref_table_set_null") (param i32))
  (func (export "__wbindgen_externref_table_grow") (param i32) (result i32) (i32.const -1)))
