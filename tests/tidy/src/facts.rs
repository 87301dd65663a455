//! What the checks need to know of one Rust file, read off its syntax tree once.
//!
//! Parsing beats counting braces: strings, character literals and nested comments need no care. What stands inside a
//! macro call (a `proptest!` block, say) is only tokens here, so functions in it are not measured.

use std::ops::RangeInclusive;

use syn::punctuated::Punctuated;
use syn::spanned::Spanned;
use syn::visit::{self, Visit};
use syn::{Attribute, Block, Meta, Signature, Token};

/// One function and the lines it takes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Function {
    /// Its name.
    pub name: String,
    /// First line of its attributes and docs, or of the signature where it has neither.
    pub head: usize,
    /// Line of the brace that opens its body.
    pub open: usize,
    /// From the signature to the closing brace.
    pub lines: RangeInclusive<usize>,
}

impl Function {
    /// Lines from the signature to the closing brace.
    #[must_use]
    pub fn len_lines(&self) -> usize {
        self.lines.end() - self.lines.start() + 1
    }
}

/// A `#[cfg(test)] mod name;` whose body is a file of its own.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TestModuleFile {
    /// Name of the module.
    pub name: String,
    /// The `#[path = "…"]` it carries, if any.
    pub path: Option<String>,
}

/// What was read off one Rust file.
#[derive(Clone, Debug, Default)]
pub struct Facts {
    /// `#![forbid(unsafe_code)]` stands at its top.
    pub forbids_unsafe: bool,
    /// `#![no_std]`, or `#![cfg_attr(not(test), no_std)]`, stands at its top.
    pub no_std: bool,
    /// Lines of items under `#[cfg(test)]`.
    pub test_lines: Vec<RangeInclusive<usize>>,
    /// Test modules that live in files of their own.
    pub test_module_files: Vec<TestModuleFile>,
    /// All functions with a body, nested ones too, in the order of the file.
    pub functions: Vec<Function>,
}

impl Facts {
    /// Reads the facts off `text`.
    ///
    /// # Errors
    /// Where `text` is not Rust that the parser knows.
    pub fn parse(text: &str) -> syn::Result<Self> {
        let file = syn::parse_file(text)?;
        let mut facts = Self {
            forbids_unsafe: file.attrs.iter().any(|attr| attr.path().is_ident("forbid") && names(attr, "unsafe_code")),
            no_std: file.attrs.iter().any(is_no_std),
            ..Self::default()
        };
        facts.visit_file(&file);
        Ok(facts)
    }

    /// Whether `line` lies in an item under `#[cfg(test)]`.
    #[must_use]
    pub fn is_test_line(&self, line: usize) -> bool {
        self.test_lines.iter().any(|lines| lines.contains(&line))
    }

    fn note_test_item(&mut self, attrs: &[Attribute], item: &impl Spanned) {
        if attrs.iter().any(is_cfg_test) {
            self.test_lines.push(item.span().start().line..=item.span().end().line);
        }
    }

    fn note_function(&mut self, attrs: &[Attribute], signature: &Signature, body: &Block) {
        let first = signature.span().start().line;
        let braces = body.brace_token.span;
        self.functions.push(Function {
            name: signature.ident.to_string(),
            head: attrs.first().map_or(first, |attr| attr.span().start().line),
            open: braces.open().start().line,
            lines: first..=braces.close().end().line,
        });
    }
}

impl<'ast> Visit<'ast> for Facts {
    fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
        self.note_test_item(&item.attrs, item);
        if item.content.is_none() && item.attrs.iter().any(is_cfg_test) {
            let path = item.attrs.iter().find_map(path_attribute);
            self.test_module_files.push(TestModuleFile { name: item.ident.to_string(), path });
        }
        visit::visit_item_mod(self, item);
    }

    fn visit_item_impl(&mut self, item: &'ast syn::ItemImpl) {
        self.note_test_item(&item.attrs, item);
        visit::visit_item_impl(self, item);
    }

    fn visit_item_fn(&mut self, item: &'ast syn::ItemFn) {
        self.note_test_item(&item.attrs, item);
        self.note_function(&item.attrs, &item.sig, &item.block);
        visit::visit_item_fn(self, item);
    }

    fn visit_impl_item_fn(&mut self, item: &'ast syn::ImplItemFn) {
        self.note_test_item(&item.attrs, item);
        self.note_function(&item.attrs, &item.sig, &item.block);
        visit::visit_impl_item_fn(self, item);
    }

    fn visit_trait_item_fn(&mut self, item: &'ast syn::TraitItemFn) {
        if let Some(body) = &item.default {
            self.note_function(&item.attrs, &item.sig, body);
        }
        visit::visit_trait_item_fn(self, item);
    }
}

/// Whether the list of an attribute has `name` as one of its entries: `#![forbid(name, other)]`.
fn names(attr: &Attribute, name: &str) -> bool {
    arguments(&attr.meta).iter().any(|meta| meta.path().is_ident(name))
}

/// Comma-separated entries of an attribute's list; empty where it has none, or none that are attributes themselves.
fn arguments(meta: &Meta) -> Vec<Meta> {
    let Meta::List(list) = meta else { return Vec::new() };
    let parsed = list.parse_args_with(Punctuated::<Meta, Token![,]>::parse_terminated);
    parsed.map(|entries| entries.into_iter().collect()).unwrap_or_default()
}

fn is_no_std(attr: &Attribute) -> bool {
    if attr.path().is_ident("no_std") {
        return true;
    }
    let [condition, attribute] = &arguments(&attr.meta)[..] else { return false };
    let only_off_in_tests =
        condition.path().is_ident("not") && arguments(condition).iter().all(|meta| meta.path().is_ident("test"));
    attr.path().is_ident("cfg_attr") && only_off_in_tests && attribute.path().is_ident("no_std")
}

/// `#[cfg(test)]` or `#[cfg(all(test, …))]`; not `any(test, …)` nor `not(test)`, which are built outside of tests too.
fn is_cfg_test(attr: &Attribute) -> bool {
    let asks_for_test = |meta: &Meta| {
        meta.path().is_ident("test")
            || (meta.path().is_ident("all") && arguments(meta).iter().any(|inner| inner.path().is_ident("test")))
    };
    attr.path().is_ident("cfg") && arguments(&attr.meta).iter().any(asks_for_test)
}

fn path_attribute(attr: &Attribute) -> Option<String> {
    let Meta::NameValue(pair) = &attr.meta else { return None };
    match &pair.value {
        syn::Expr::Lit(syn::ExprLit { lit: syn::Lit::Str(path), .. }) if pair.path.is_ident("path") => {
            Some(path.value())
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crate_attributes_are_read() {
        let facts = Facts::parse("//! Docs.\n#![no_std]\n#![forbid(missing_docs, unsafe_code)]\n").unwrap();
        assert!(facts.no_std && facts.forbids_unsafe);
        assert!(Facts::parse("#![cfg_attr(not(test), no_std)]\n").unwrap().no_std);
    }

    #[test]
    fn weaker_crate_attributes_are_not_taken_for_the_real_ones() {
        let facts = Facts::parse("#![deny(unsafe_code)]\n#![cfg_attr(feature = \"small\", no_std)]\n").unwrap();
        assert!(!facts.no_std && !facts.forbids_unsafe);
        assert!(!Facts::parse("#![forbid(missing_docs)]\n").unwrap().forbids_unsafe);
    }

    #[test]
    fn lines_of_test_items_are_known_and_those_of_others_are_not() {
        let text = "fn a() {}\n#[cfg(test)]\nmod tests {\n    fn b() {}\n}\n#[cfg(not(test))]\nmod c {}\n\
                    #[cfg(all(test, feature = \"x\"))]\nmod d {}\n#[cfg(any(test, feature = \"x\"))]\nmod e {}\n";
        let facts = Facts::parse(text).unwrap();
        let inside: Vec<usize> = (1..=11).filter(|&line| facts.is_test_line(line)).collect();
        assert_eq!(inside, [2, 3, 4, 5, 8, 9]);
    }

    #[test]
    fn test_modules_in_files_of_their_own_are_named() {
        let facts =
            Facts::parse("#[cfg(test)]\nmod tests;\n#[cfg(test)]\n#[path = \"deep.rs\"]\nmod b;\nmod c;\n").unwrap();
        let named: Vec<_> = facts.test_module_files.iter().map(|file| (&file.name[..], file.path.as_deref())).collect();
        assert_eq!(named, [("tests", None), ("b", Some("deep.rs"))]);
    }

    #[test]
    fn braces_in_strings_and_comments_do_not_change_a_functions_length() {
        let text = "/// Docs.\n#[inline]\nfn a(\n    b: u8,\n) -> char {\n    let _ = \"{{{\"; // }}}\n    '}'\n}\nfn c() {}\n";
        let facts = Facts::parse(text).unwrap();
        let [a, c] = &facts.functions[..] else { panic!("two functions, got {:?}", facts.functions) };
        assert_eq!((a.head, a.open, a.len_lines()), (1, 5, 6));
        assert_eq!((c.head, c.open, c.len_lines()), (9, 9, 1));
    }

    #[test]
    fn methods_and_default_bodies_of_traits_are_functions_too() {
        let facts = Facts::parse("impl A { fn a() {} }\ntrait B { fn b() {} fn no_body(); }\n").unwrap();
        let named: Vec<_> = facts.functions.iter().map(|function| &function.name[..]).collect();
        assert_eq!(named, ["a", "b"]);
    }
}
