//! Message definitions in OMG IDL 4.2 as stored by rosbag2: files, each after a line of `=` and a line
//! `IDL: package/msg/Type`.
//!
//! Keeps only what determines the byte layout: structures, aliases, enumerations, constants for lengths,
//! and the annotations for extensibility and optional members.

mod tokens;

use std::collections::{HashMap, HashSet};

use self::tokens::{Token, Tokens};
use super::schema::{
    self, Arity, Base, Definition, Extensibility, Field, MAX_DEPTH, MAX_FIELDS, MAX_TYPES,
    Primitive, Schema, SchemaError, canonical,
};

pub(super) fn parse(type_name: &str, schema: &[u8]) -> Result<Schema, SchemaError> {
    let text = schema::text(schema)?;
    let mut parser = Parser { tokens: Tokens::new(&text), ..Parser::default() };
    while !parser.tokens.is_at_end() {
        parser.definition(0)?;
    }
    Schema::new(type_name, parser.resolve()?)
}

#[derive(Clone, Debug)]
struct Type {
    base: Base,
    arity: Arity,
}

/// Structure with unresolved names.
struct Struct {
    /// Enclosing modules, each followed by `/`.
    scope: String,
    name: String,
    fields: Vec<Field>,
    extensibility: Extensibility,
}

/// Names are fully qualified, with `/` between modules.
#[derive(Default)]
struct Parser<'a> {
    tokens: Tokens<'a>,
    scope: String,
    structs: Vec<Struct>,
    struct_names: HashSet<String>,
    /// Aliases with the scope of their type.
    aliases: HashMap<String, (String, Type)>,
    constants: HashMap<String, u64>,
    fields: usize,
}

#[derive(Clone, Copy)]
struct Annotations {
    extensibility: Extensibility,
    is_optional: bool,
    /// Size of an enumeration, bits.
    bit_bound: u64,
}

impl Parser<'_> {
    /// Definition in a file or module.
    fn definition(&mut self, depth: usize) -> Result<(), SchemaError> {
        if depth > MAX_DEPTH {
            return Err(SchemaError::TooDeep { field: self.scope.clone() });
        }
        if self.structs.len() + self.aliases.len() > MAX_TYPES {
            return Err(SchemaError::TooManyTypes);
        }
        let annotations = self.annotations()?;
        if self.tokens.accept(';') || self.tokens.is_at_end() {
            return Ok(());
        }
        let word = self.tokens.name("a definition")?;
        match word {
            "module" => self.module(depth),
            "struct" => self.structure(annotations.extensibility),
            "typedef" => self.typedef(),
            "const" => self.constant(),
            "enum" => self.enumeration(annotations.bit_bound),
            "union" => self.opaque("which is a union"),
            "bitmask" | "bitset" => self.opaque("which is a set of bits"),
            _ => self.tokens.refuse("`module`, `struct`, `typedef`, `const` or `enum`", word),
        }
    }

    fn module(&mut self, depth: usize) -> Result<(), SchemaError> {
        let name = self.tokens.name("the name of a module")?;
        let outer = self.scope.len();
        self.scope.push_str(name);
        self.scope.push('/');
        self.tokens.expect('{')?;
        while !self.tokens.accept('}') {
            if self.tokens.is_at_end() {
                return self.tokens.expect('}');
            }
            self.definition(depth + 1)?;
        }
        self.scope.truncate(outer);
        Ok(())
    }

    fn structure(&mut self, extensibility: Extensibility) -> Result<(), SchemaError> {
        let name = self.tokens.name("the name of a structure")?.to_owned();
        let mut fields = Vec::new();
        if self.tokens.accept(';') {
            return Ok(());
        }
        if self.tokens.accept(':') {
            let spelled = self.tokens.name("the name of a structure")?.to_owned();
            let base = Base::Unreadable("from which the structure inherits");
            fields.push(Field { name: spelled.clone(), base, arity: Arity::One, spelled });
        }
        self.tokens.expect('{')?;
        while !self.tokens.accept('}') {
            self.member(&mut fields)?;
        }
        let scope = self.scope.clone();
        self.push(Struct { scope, name, fields, extensibility });
        Ok(())
    }

    fn member(&mut self, fields: &mut Vec<Field>) -> Result<(), SchemaError> {
        let annotations = self.annotations()?;
        let before = self.tokens.here();
        let of = self.type_of(0)?;
        let spelled = self.tokens.since(before);
        loop {
            let name = self.tokens.name("the name of a member")?;
            // An underscore escapes keywords.
            let name = name.strip_prefix('_').unwrap_or(name).to_owned();
            let dimensions = self.dimensions()?;
            let mut of = self.array(of.clone(), dimensions);
            if annotations.is_optional {
                of.base = Base::Unreadable("which is optional");
            }
            let Type { base, arity } = of;
            fields.push(Field { name, base, arity, spelled: spelled.clone() });
            self.count_field()?;
            if !self.tokens.accept(',') {
                return self.tokens.expect(';');
            }
        }
    }

    fn count_field(&mut self) -> Result<(), SchemaError> {
        self.fields += 1;
        if self.fields > MAX_FIELDS { Err(SchemaError::TooManyFields) } else { Ok(()) }
    }

    fn typedef(&mut self) -> Result<(), SchemaError> {
        let of = self.type_of(0)?;
        loop {
            let name = self.tokens.name("the name of a type")?.to_owned();
            let dimensions = self.dimensions()?;
            let of = self.array(of.clone(), dimensions);
            self.aliases.insert(format!("{}{name}", self.scope), (self.scope.clone(), of));
            self.count_field()?;
            if !self.tokens.accept(',') {
                return self.tokens.expect(';');
            }
        }
    }

    /// Only integers can be lengths.
    fn constant(&mut self) -> Result<(), SchemaError> {
        self.type_of(0)?;
        let name = self.tokens.name("the name of a constant")?;
        let name = format!("{}{name}", self.scope);
        self.tokens.expect('=')?;
        let value = self.tokens.take();
        if let (Some(Token::Number(text)), Some(Token::Mark(';'))) = (value, self.tokens.peek())
            && let Some(value) = whole(text)
        {
            self.constants.insert(name, value);
            self.count_field()?;
        }
        self.tokens.skip_to(';')
    }

    /// The bit bound determines the size of its values (DDS XTypes 1.3, §7.3.1.2.1.5: 32 bits by default).
    fn enumeration(&mut self, bit_bound: u64) -> Result<(), SchemaError> {
        let name = self.tokens.name("the name of an enumeration")?;
        let primitive = match bit_bound {
            0..=8 => Primitive::U8,
            9..=16 => Primitive::U16,
            _ => Primitive::U32,
        };
        let of = Type { base: Base::Enumeration(primitive), arity: Arity::One };
        self.aliases.insert(format!("{}{name}", self.scope), (self.scope.clone(), of));
        self.tokens.skip_block()
    }

    /// Skips and records a type that cannot be decoded.
    fn opaque(&mut self, why: &'static str) -> Result<(), SchemaError> {
        let name = self.tokens.name("the name of a type")?;
        let of = Type { base: Base::Unreadable(why), arity: Arity::One };
        self.aliases.insert(format!("{}{name}", self.scope), (self.scope.clone(), of));
        self.tokens.skip_block()
    }

    fn annotations(&mut self) -> Result<Annotations, SchemaError> {
        let mut found = Annotations {
            extensibility: Extensibility::Undeclared,
            is_optional: false,
            bit_bound: 32,
        };
        while self.tokens.accept('@') {
            let name = self.tokens.name("the name of an annotation")?;
            let value = self.tokens.parenthesized()?;
            match (name, value) {
                ("final", _) | ("extensibility", Some("FINAL")) => {
                    found.extensibility = Extensibility::Final;
                }
                ("appendable", _) | ("extensibility", Some("APPENDABLE")) => {
                    found.extensibility = Extensibility::Appendable;
                }
                ("mutable", _) | ("extensibility", Some("MUTABLE")) => {
                    found.extensibility = Extensibility::Mutable;
                }
                ("optional", value) => found.is_optional = value != Some("FALSE"),
                ("bit_bound", Some(value)) => found.bit_bound = whole(value).unwrap_or(32),
                _ => {}
            }
        }
        Ok(found)
    }

    /// Dimensions may follow after the member's name.
    fn type_of(&mut self, depth: usize) -> Result<Type, SchemaError> {
        if depth > MAX_DEPTH {
            return Err(SchemaError::TooDeep { field: self.scope.clone() });
        }
        let word = self.tokens.name("a type")?;
        let base = match word {
            "sequence" => {
                self.tokens.expect('<')?;
                let element = self.type_of(depth + 1)?;
                if self.tokens.accept(',') {
                    self.tokens.take();
                }
                self.tokens.expect('>')?;
                let base = self.element(element);
                return Ok(Type { base, arity: Arity::Sequence });
            }
            "string" => {
                self.tokens.skip_bound()?;
                Base::Text
            }
            "wstring" => {
                self.tokens.skip_bound()?;
                Base::Unreadable("which has no settled encoding")
            }
            "wchar" => Base::Unreadable("which has no settled encoding"),
            "map" | "fixed" => {
                self.tokens.skip_bound()?;
                Base::Unreadable("which is not read here")
            }
            "any" => Base::Unreadable("which is not read here"),
            "unsigned" | "long" | "short" => return self.old_integer(word),
            _ => match primitive(word) {
                Some(primitive) => Base::Number(primitive),
                None => Base::Message(word.replace("::", "/")),
            },
        };
        Ok(Type { base, arity: Arity::One })
    }

    /// Rest of a C-style integer name.
    fn old_integer(&mut self, first: &str) -> Result<Type, SchemaError> {
        let mut words = vec![first.to_owned()];
        while let Some(Token::Name(word @ ("long" | "short" | "double"))) = self.tokens.peek() {
            words.push(word.to_owned());
            self.tokens.take();
        }
        let base = match words.join(" ").as_str() {
            "short" => Base::Number(Primitive::I16),
            "unsigned short" => Base::Number(Primitive::U16),
            "long" => Base::Number(Primitive::I32),
            "unsigned long" => Base::Number(Primitive::U32),
            "long long" => Base::Number(Primitive::I64),
            "unsigned long long" => Base::Number(Primitive::U64),
            "long double" => Base::Unreadable("which is not read here"),
            other => return self.tokens.refuse("a type", other),
        };
        Ok(Type { base, arity: Arity::One })
    }

    /// Product of the dimensions after a name.
    fn dimensions(&mut self) -> Result<Option<u32>, SchemaError> {
        let mut length: Option<u32> = None;
        while self.tokens.accept('[') {
            let dimension = match self.tokens.take() {
                Some(Token::Number(text)) => whole(text),
                Some(Token::Name(name)) => {
                    let name = name.replace("::", "/");
                    innermost(&self.scope, &name, |name| self.constants.get(name).copied())
                }
                _ => None,
            };
            let product = dimension
                .and_then(|dimension| u32::try_from(dimension).ok())
                .and_then(|dimension| length.unwrap_or(1).checked_mul(dimension))
                .filter(|&product| product > 0);
            if product.is_none() {
                return self.tokens.refuse("a length from 1 to 4294967295", "another one");
            }
            length = product;
            self.tokens.expect(']')?;
        }
        Ok(length)
    }

    fn array(&mut self, of: Type, dimensions: Option<u32>) -> Type {
        match dimensions {
            None => of,
            Some(length) => Type { base: self.element(of), arity: Arity::Array(length) },
        }
    }

    /// Element of an array or sequence `of`. A nested array becomes a structure with one unnamed field.
    fn element(&mut self, of: Type) -> Base {
        let Type { base, arity: arity @ (Arity::Array(_) | Arity::Sequence) } = of else {
            return of.base;
        };
        // Names in a file cannot start with a slash.
        let name = format!("/{}", self.structs.len());
        let fields =
            vec![Field { name: String::new(), base, arity, spelled: "an array in it".into() }];
        let scope = self.scope.clone();
        let base = Base::Message(format!("{scope}{name}"));
        self.push(Struct { scope, name, fields, extensibility: Extensibility::Final });
        base
    }

    fn push(&mut self, of: Struct) {
        self.struct_names.insert(format!("{}{}", of.scope, of.name));
        self.structs.push(of);
    }

    fn resolve(mut self) -> Result<Vec<Definition>, SchemaError> {
        // Aliases of arrays may add structures.
        let mut index = 0;
        let mut definitions = Vec::new();
        while index < self.structs.len() {
            let scope = self.structs[index].scope.clone();
            let mut fields = std::mem::take(&mut self.structs[index].fields);
            for field in &mut fields {
                let of = Type { base: field.base.clone(), arity: field.arity };
                Type { base: field.base, arity: field.arity } =
                    self.without_aliases(&scope, of, 0)?;
            }
            let Struct { name, extensibility, .. } = &self.structs[index];
            let name = canonical(&format!("{scope}{name}")).into_owned();
            definitions.push(Definition { name, fields, extensibility: *extensibility });
            index += 1;
            if index > 2 * MAX_FIELDS {
                return Err(SchemaError::TooManyTypes);
            }
        }
        Ok(definitions)
    }

    fn without_aliases(
        &mut self,
        scope: &str,
        of: Type,
        depth: usize,
    ) -> Result<Type, SchemaError> {
        let Base::Message(name) = &of.base else { return Ok(of) };
        if depth > MAX_DEPTH {
            return Err(SchemaError::TooDeep { field: name.clone() });
        }
        let aliased = innermost(scope, name, |name| self.aliases.get(name).cloned());
        let Some((scope, aliased)) = aliased else {
            let whole = innermost(scope, name, |whole| self.struct_names.get(whole).cloned());
            let whole = whole.as_deref().unwrap_or_else(|| name.trim_start_matches('/'));
            let name = canonical(whole).into_owned();
            return Ok(Type { base: Base::Message(name), arity: of.arity });
        };
        let aliased = self.without_aliases(&scope, aliased, depth + 1)?;
        if of.arity == Arity::One {
            return Ok(aliased);
        }
        Ok(Type { base: self.element(aliased), arity: of.arity })
    }
}

/// Searches the modules of `scope`, innermost first.
fn innermost<T>(scope: &str, name: &str, find: impl Fn(&str) -> Option<T>) -> Option<T> {
    if let Some(whole) = name.strip_prefix('/') {
        return find(whole).or_else(|| find(name));
    }
    let ends = scope.rmatch_indices('/').map(|(at, _)| at + 1).chain([0]);
    ends.into_iter().find_map(|end| find(&format!("{}{name}", &scope[..end])))
}

fn primitive(word: &str) -> Option<Primitive> {
    Some(match word {
        "boolean" | "octet" | "char" | "uint8" => Primitive::U8,
        "int8" => Primitive::I8,
        "int16" => Primitive::I16,
        "uint16" => Primitive::U16,
        "int32" => Primitive::I32,
        "uint32" => Primitive::U32,
        "int64" => Primitive::I64,
        "uint64" => Primitive::U64,
        "float" => Primitive::F32,
        "double" => Primitive::F64,
        _ => return None,
    })
}

/// Parses an integer in any base.
fn whole(text: &str) -> Option<u64> {
    match text.as_bytes() {
        [b'0', b'x' | b'X', ..] => u64::from_str_radix(&text[2..], 16).ok(),
        [b'0', _, ..] => u64::from_str_radix(&text[1..], 8).ok(),
        _ => text.parse().ok(),
    }
}
