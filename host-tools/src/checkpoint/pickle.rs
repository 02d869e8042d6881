//! A pickle reader that understands data and nothing else.
//!
//! Pickle is a program for a stack machine that may call any Python function. This interpreter knows the opcodes `torch.save`
//! uses (protocol 2 and the plain ones of 4), builds values in a pool addressed by index (so sharing and cycles cost
//! nothing and nothing recurses), and "calls" only the names of `Global`: containers become containers, a tensor becomes a
//! description of where its bytes lie. Any other name is an error; nothing is executed.
//!
//! Why not a library: a general reader builds whatever a pickle asks for and leaves it to the caller to distrust the result. Here the
//! list of permitted names is the reader, and what is not on it is refused with its place in the file.

use std::collections::HashMap;

use super::error::{ErrorKind, Result};

/// Tuples that are arguments are short; longer ones would make repeated calls costly.
const MAX_ARGUMENTS: usize = 16;
/// Dimensions of a tensor.
const MAX_DIMENSIONS: usize = 8;
/// Bytes of a storage key, a module or an attribute name.
const MAX_NAME: usize = 256;

/// Index of a value in the pool.
pub type Id = usize;

/// Element type of a torch storage, by the storage class that the pickle names.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Element {
    /// Safetensors-style name ("F32", "I64", ...).
    pub name: &'static str,
    /// Bytes of one element.
    pub size: usize,
}

/// Python objects that may appear.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Global {
    /// `collections.OrderedDict`, `collections.defaultdict`, `collections.Counter`, `builtins.dict`.
    Dict,
    /// `torch._utils._rebuild_tensor_v2`.
    RebuildTensor,
    /// `torch._utils._rebuild_parameter`.
    RebuildParameter,
    /// A storage class.
    Storage(Element),
    /// `torch.Size`, `builtins.set`, ...: kept as an opaque value.
    Opaque,
}

/// Where a tensor's numbers lie in the container.
#[derive(Debug, Clone, PartialEq)]
pub struct TensorRef {
    /// Key of the storage: the entry `<root>/data/<key>`.
    pub key: String,
    /// Element type of the storage.
    pub element: Element,
    /// Number of elements of the storage.
    pub numel: usize,
    /// First element.
    pub offset: usize,
    /// Extents.
    pub shape: Vec<usize>,
    /// Distance between neighbours along each dimension, in elements.
    pub strides: Vec<usize>,
}

/// A value.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// `None`, `bytes`, floats and objects that carry nothing we need.
    Opaque,
    /// `True`, `False`.
    Bool(bool),
    /// Integers of up to 64 bits.
    Int(i64),
    /// Text.
    Text(String),
    /// Tuples.
    Tuple(Vec<Id>),
    /// Lists and sets.
    List(Vec<Id>),
    /// Dictionaries of any kind, in order.
    Dict(Vec<(Id, Id)>),
    /// A name that was looked up.
    Global(Global),
    /// A persistent id: a storage.
    StorageRef {
        /// Element type.
        element: Element,
        /// Key of the storage.
        key: String,
        /// Number of elements.
        numel: usize,
    },
    /// A tensor.
    Tensor(TensorRef),
}

/// The result of reading a pickle: a pool of values and the root.
#[derive(Debug)]
pub struct Pickle {
    pool: Vec<Value>,
    root: Id,
}

impl Pickle {
    /// Runs the program.
    ///
    /// # Errors
    /// [`ErrorKind::Pickle`] on malformed input, [`ErrorKind::ForbiddenGlobal`] on any name that is not data.
    pub fn parse(bytes: &[u8]) -> Result<Self> {
        Machine {
            bytes,
            at: 0,
            op_at: 0,
            pool: Vec::new(),
            stack: Vec::new(),
            marks: Vec::new(),
            memo: HashMap::new(),
            copied: 0,
        }
        .run()
    }

    /// The value of an index.
    #[must_use]
    pub fn value(&self, id: Id) -> &Value {
        self.pool.get(id).unwrap_or(&Value::Opaque)
    }

    /// The outermost value.
    #[must_use]
    pub fn root(&self) -> Id {
        self.root
    }

    /// Key and value of the text keys of a dictionary; empty for anything else.
    pub fn entries(&self, id: Id) -> impl Iterator<Item = (&str, Id)> {
        let pairs = match self.value(id) {
            Value::Dict(pairs) => pairs.as_slice(),
            _ => &[],
        };
        pairs.iter().filter_map(|&(k, v)| match self.value(k) {
            Value::Text(text) => Some((text.as_str(), v)),
            _ => None,
        })
    }
}

/// The stack machine.
struct Machine<'a> {
    bytes: &'a [u8],
    at: usize,
    op_at: usize,
    pool: Vec<Value>,
    stack: Vec<Id>,
    marks: Vec<usize>,
    memo: HashMap<u32, Id>,
    copied: usize,
}

impl Machine<'_> {
    fn bad(&self, what: impl Into<String>) -> ErrorKind {
        ErrorKind::Pickle { what: what.into(), at: self.op_at }
    }

    fn take(&mut self, n: usize) -> Result<&[u8]> {
        let end = self.at.checked_add(n).filter(|&e| e <= self.bytes.len());
        let end = end.ok_or_else(|| self.bad(format!("an argument of {n} bytes runs over the end")))?;
        let slice = &self.bytes[self.at..end];
        self.at = end;
        Ok(slice)
    }

    fn unsigned(&mut self, n: usize) -> Result<usize> {
        let value = self.take(n)?.iter().rev().try_fold(0_u64, |v, &b| v.checked_mul(256).map(|v| v + u64::from(b)));
        value.and_then(|v| usize::try_from(v).ok()).ok_or_else(|| self.bad("number too large"))
    }

    fn text(&mut self, n: usize) -> Result<String> {
        let bytes = self.take(n)?.to_vec();
        String::from_utf8(bytes).map_err(|_| self.bad("text is not UTF-8"))
    }

    fn line(&mut self) -> Result<String> {
        let rest = &self.bytes[self.at..];
        let n = rest.iter().position(|&b| b == b'\n').ok_or_else(|| self.bad("unterminated line"))?;
        let text = self.text(n)?;
        self.at += 1;
        Ok(text)
    }

    fn push(&mut self, value: Value) {
        self.pool.push(value);
        self.stack.push(self.pool.len() - 1);
    }

    fn pop(&mut self) -> Result<Id> {
        let floor = self.marks.last().copied().unwrap_or(0);
        if self.stack.len() <= floor {
            return Err(self.bad("stack underflow"));
        }
        self.stack.pop().ok_or_else(|| self.bad("stack underflow"))
    }

    fn top(&self) -> Result<Id> {
        self.stack.last().copied().ok_or_else(|| self.bad("stack underflow"))
    }

    fn pop_mark(&mut self) -> Result<Vec<Id>> {
        let mark = self.marks.pop().ok_or_else(|| self.bad("no mark on the stack"))?;
        if mark > self.stack.len() {
            return Err(self.bad("stack underflow"));
        }
        Ok(self.stack.split_off(mark))
    }

    fn put(&mut self, index: usize) -> Result<()> {
        let index = u32::try_from(index).map_err(|_| self.bad("memo index too large"))?;
        let top = self.top()?;
        self.memo.insert(index, top);
        Ok(())
    }

    fn get(&mut self, index: usize) -> Result<()> {
        let id = u32::try_from(index).ok().and_then(|i| self.memo.get(&i).copied());
        let id = id.ok_or_else(|| self.bad(format!("memo entry {index} was never stored")))?;
        self.stack.push(id);
        Ok(())
    }

    fn run(mut self) -> Result<Pickle> {
        loop {
            self.op_at = self.at;
            let op = self.take(1)?[0];
            if op == b'.' {
                let root = self.pop()?;
                return Ok(Pickle { pool: self.pool, root });
            }
            self.step(op)?;
        }
    }

    fn step(&mut self, op: u8) -> Result<()> {
        match op {
            0x80 => {
                let version = self.unsigned(1)?;
                if !(2..=5).contains(&version) {
                    return Err(self.bad(format!("pickle protocol {version}, expected 2 to 5")));
                }
            }
            0x95 => {
                self.take(8)?; // FRAME: a hint about lengths, of no consequence here
            }
            b'(' => self.marks.push(self.stack.len()),
            b'0' => {
                self.pop()?;
            }
            b'2' => {
                let top = self.top()?;
                self.stack.push(top);
            }
            b'N' => self.push(Value::Opaque),
            0x88 => self.push(Value::Bool(true)),
            0x89 => self.push(Value::Bool(false)),
            b'J' => {
                let raw = self.unsigned(4)? as u32;
                self.push(Value::Int(i64::from(raw.cast_signed())));
            }
            b'K' => {
                let value = self.unsigned(1)? as i64;
                self.push(Value::Int(value));
            }
            b'M' => {
                let value = self.unsigned(2)? as i64;
                self.push(Value::Int(value));
            }
            0x8a => self.long()?,
            b'G' => {
                self.take(8)?;
                self.push(Value::Opaque);
            }
            b'X' | 0x8c | 0x8d => {
                let n = self.unsigned(length_bytes(op))?;
                let text = self.text(n)?;
                self.push(Value::Text(text));
            }
            b'U' | b'T' | b'C' | b'B' | 0x8e => {
                let n = self.unsigned(length_bytes(op))?;
                self.take(n)?;
                self.push(Value::Opaque);
            }
            b'}' => self.push(Value::Dict(Vec::new())),
            b']' | 0x8f => self.push(Value::List(Vec::new())),
            b')' => self.push(Value::Tuple(Vec::new())),
            0x85..=0x87 => {
                let mut items = Vec::new();
                for _ in 0..op - 0x84 {
                    items.push(self.pop()?);
                }
                items.reverse();
                self.push(Value::Tuple(items));
            }
            b't' => {
                let items = self.pop_mark()?;
                self.push(Value::Tuple(items));
            }
            b'q' | b'r' => {
                let index = self.unsigned(length_bytes(op))?;
                self.put(index)?;
            }
            0x94 => self.put(self.memo.len())?,
            b'h' | b'j' => {
                let index = self.unsigned(length_bytes(op))?;
                self.get(index)?;
            }
            b's' => {
                let (value, key) = (self.pop()?, self.pop()?);
                self.set_items(&[key, value])?;
            }
            b'u' => {
                let items = self.pop_mark()?;
                self.set_items(&items)?;
            }
            b'a' => {
                let item = self.pop()?;
                self.append(&[item])?;
            }
            b'e' | 0x90 => {
                let items = self.pop_mark()?;
                self.append(&items)?;
            }
            b'c' => {
                let (module, name) = (self.line()?, self.line()?);
                self.global(&module, &name)?;
            }
            0x93 => {
                let (name, module) = (self.pop()?, self.pop()?);
                match (&self.pool[module], &self.pool[name]) {
                    (Value::Text(module), Value::Text(name)) if module.len().max(name.len()) <= MAX_NAME => {
                        let (module, name) = (module.clone(), name.clone());
                        self.global(&module, &name)?;
                    }
                    _ => return Err(self.bad("a global's name is not a short text")),
                }
            }
            b'Q' => self.persistent()?,
            b'R' | 0x81 => self.reduce()?,
            b'b' => {
                // BUILD: attributes of an object (a state dict's `_metadata`), of no consequence here.
                self.pop()?;
                self.top()?;
            }
            other => return Err(self.bad(format!("opcode {other:#04x} is not one that torch.save writes"))),
        }
        Ok(())
    }

    fn long(&mut self) -> Result<()> {
        let n = self.unsigned(1)?;
        let bytes = self.take(n)?;
        let value = if n > 8 {
            Value::Opaque
        } else {
            let fill = if bytes.last().is_some_and(|b| b & 0x80 != 0) { 0xff } else { 0 };
            let mut wide = [fill; 8];
            wide[..n].copy_from_slice(bytes);
            Value::Int(i64::from_le_bytes(wide))
        };
        self.push(value);
        Ok(())
    }

    fn set_items(&mut self, items: &[Id]) -> Result<()> {
        let target = self.top()?;
        if !items.len().is_multiple_of(2) {
            return Err(self.bad("odd number of keys and values"));
        }
        match &mut self.pool[target] {
            Value::Dict(pairs) => pairs.extend(items.chunks_exact(2).map(|p| (p[0], p[1]))),
            Value::Opaque => {}
            _ => return Err(self.bad("items are set on something that is not a dictionary")),
        }
        Ok(())
    }

    fn append(&mut self, items: &[Id]) -> Result<()> {
        let target = self.top()?;
        match &mut self.pool[target] {
            Value::List(list) => list.extend_from_slice(items),
            Value::Opaque => {}
            _ => return Err(self.bad("items are appended to something that is not a list")),
        }
        Ok(())
    }

    fn global(&mut self, module: &str, name: &str) -> Result<()> {
        let element = |name, size| Global::Storage(Element { name, size });
        let global = match (module, name) {
            ("collections", "OrderedDict" | "defaultdict" | "Counter") | ("builtins" | "__builtin__", "dict") => {
                Global::Dict
            }
            ("torch._utils", "_rebuild_tensor_v2") => Global::RebuildTensor,
            ("torch._utils", "_rebuild_parameter") => Global::RebuildParameter,
            ("torch", "FloatStorage") => element("F32", 4),
            ("torch", "DoubleStorage") => element("F64", 8),
            ("torch", "HalfStorage") => element("F16", 2),
            ("torch", "BFloat16Storage") => element("BF16", 2),
            ("torch", "LongStorage") => element("I64", 8),
            ("torch", "IntStorage") => element("I32", 4),
            ("torch", "ShortStorage") => element("I16", 2),
            ("torch", "CharStorage") => element("I8", 1),
            ("torch", "ByteStorage") => element("U8", 1),
            ("torch", "BoolStorage") => element("BOOL", 1),
            ("torch", "Size") | ("builtins" | "__builtin__", "set" | "list" | "int" | "float") => Global::Opaque,
            _ => {
                return Err(ErrorKind::ForbiddenGlobal {
                    module: module.to_owned(),
                    name: name.to_owned(),
                    at: self.op_at,
                });
            }
        };
        self.push(Value::Global(global));
        Ok(())
    }

    /// `('storage', class, key, device, numel)`.
    fn persistent(&mut self) -> Result<()> {
        let id = self.pop()?;
        let Value::Tuple(parts) = &self.pool[id] else {
            return Err(self.bad("a persistent id is not a tuple"));
        };
        let values: Vec<&Value> = parts.iter().take(MAX_ARGUMENTS).map(|&p| &self.pool[p]).collect();
        match values[..] {
            [Value::Text(kind), Value::Global(Global::Storage(element)), Value::Text(key), _, Value::Int(numel)]
                if kind == "storage" && *numel >= 0 && key.len() <= MAX_NAME && parts.len() == 5 =>
            {
                let value = Value::StorageRef { element: *element, key: key.clone(), numel: *numel as usize };
                self.push(value);
                Ok(())
            }
            _ => Err(self.bad("a persistent id does not describe a storage")),
        }
    }

    fn reduce(&mut self) -> Result<()> {
        let (arguments, callee) = (self.pop()?, self.pop()?);
        let arguments = match &self.pool[arguments] {
            Value::Tuple(items) if items.len() <= MAX_ARGUMENTS => items.clone(),
            _ => return Err(self.bad("arguments of a call are not a short tuple")),
        };
        let Value::Global(callee) = self.pool[callee] else {
            return Err(self.bad("a call of something that is not a known name"));
        };
        match callee {
            Global::Dict => {
                let pairs = arguments.first().map_or_else(Vec::new, |&a| match &self.pool[a] {
                    Value::Dict(pairs) => pairs.clone(),
                    _ => Vec::new(),
                });
                // A copy costs memory that the file did not pay for: all copies together may not exceed the file.
                self.copied += pairs.len();
                if self.copied > self.bytes.len() {
                    return Err(self.bad("dictionaries are copied over and over"));
                }
                self.push(Value::Dict(pairs));
            }
            Global::RebuildParameter => {
                let tensor = arguments.first().copied().ok_or_else(|| self.bad("a parameter without a tensor"))?;
                self.stack.push(tensor);
            }
            Global::RebuildTensor => {
                let tensor = self.tensor(&arguments)?;
                self.push(Value::Tensor(tensor));
            }
            Global::Opaque => self.push(Value::Opaque),
            Global::Storage(_) => return Err(self.bad("a storage class is called")),
        }
        Ok(())
    }

    /// `(storage, offset, size, stride, requires_grad, hooks[, metadata])`.
    fn tensor(&self, arguments: &[Id]) -> Result<TensorRef> {
        let extents = |id: Id| -> Option<Vec<usize>> {
            let Value::Tuple(items) = &self.pool[id] else { return None };
            if items.len() > MAX_DIMENSIONS {
                return None;
            }
            items
                .iter()
                .map(|&i| match self.pool[i] {
                    Value::Int(v) => usize::try_from(v).ok(),
                    _ => None,
                })
                .collect()
        };
        let parse = || {
            let [storage, offset, size, stride, ..] = arguments else { return None };
            let Value::StorageRef { element, key, numel } = &self.pool[*storage] else { return None };
            let Value::Int(offset) = self.pool[*offset] else { return None };
            Some(TensorRef {
                key: key.clone(),
                element: *element,
                numel: *numel,
                offset: usize::try_from(offset).ok()?,
                shape: extents(*size)?,
                strides: extents(*stride)?,
            })
        };
        parse()
            .filter(|t| t.shape.len() == t.strides.len())
            .ok_or_else(|| self.bad("a tensor's description is malformed"))
    }
}

/// Width of the length or index field of an opcode.
fn length_bytes(op: u8) -> usize {
    match op {
        b'U' | b'C' | b'q' | b'h' | 0x8c => 1,
        0x8d | 0x8e => 8,
        _ => 4,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shared_and_cyclic_values_are_harmless() {
        // d = {}; d['a'] = d
        let pickle = Pickle::parse(b"\x80\x02}q\x00X\x01\x00\x00\x00ah\x00s.").expect("a cyclic dictionary");
        let (key, value) = pickle.entries(pickle.root()).next().expect("one entry");
        assert_eq!((key, value), ("a", pickle.root()));
    }

    #[test]
    fn calls_are_refused() {
        // The classic: os.system("true").
        let program = b"\x80\x02cposix\nsystem\nX\x04\x00\x00\x00true\x85R.";
        let error = Pickle::parse(program).expect_err("a call was accepted");
        assert!(
            matches!(error, ErrorKind::ForbiddenGlobal { ref module, ref name, at: 2 } if module == "posix" && name == "system"),
            "{error}"
        );
    }

    #[test]
    fn every_truncation_is_an_error() {
        let program = b"\x80\x02}q\x00(X\x01\x00\x00\x00aK\x05X\x01\x00\x00\x00b(K\x01tu.";
        Pickle::parse(program).expect("the whole program");
        for n in 0..program.len() {
            assert!(matches!(Pickle::parse(&program[..n]), Err(ErrorKind::Pickle { .. })), "cut at {n}");
        }
    }

    #[test]
    fn marks_protect_the_stack() {
        for program in [&b"\x80\x02K\x01(0."[..], b"\x80\x02t.", b"\x80\x02(0.", b"\x80\x02h\x05."] {
            assert!(matches!(Pickle::parse(program), Err(ErrorKind::Pickle { .. })), "{program:?}");
        }
    }
}
