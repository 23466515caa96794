//! The session of the page that runs atomesh in a browser: a WebAssembly module that stays in memory and
//! answers requests.
//!
//! The page starts the program, which does nothing but initialise the C library. Then the page puts a
//! request on standard input, as JSON, and calls [`answer_request`]. The reply is on standard output: the
//! length of a JSON text in four bytes, this text, and the numbers of the arrays that
//! it lists. Progress is printed on standard error, as the program prints it. Files are those of the WASI
//! system of the page.
//!
//! | request | reply |
//! |---|---|
//! | `{"do": "run", "line": LINE}` | the report of a line of a script, and what it changed |
//! | `{"do": "prepare", "mesh": NAME, "image": NAME}` | nothing; the first edit takes less time then |
//! | `{"do": "undo"}`, `{"do": "redo"}` | what that changed |
//! | `{"do": "write", "mesh": NAME}` | nothing; the file of the mesh is written |
//!
//! Every reply has the lines of the actions that are done and that were undone, or the `error`.

use std::cell::RefCell;
use std::io::{Read, Write, stdin, stdout};
use std::path::PathBuf;

use atomesh::cli::allocator::OomExitAllocator;
use atomesh::cli::console::{error_line, print_stderr};
use atomesh::cli::{run_line, with_console};
use atomesh::workbench::{ArrayPatch, MeshPatch, Workbench};
use serde::Deserialize;
use serde_json::{Map, Value, json};

#[global_allocator]
static ALLOCATOR: OomExitAllocator = OomExitAllocator;

thread_local! {
    static WORKBENCH: RefCell<Workbench> = RefCell::default();
}

/// A request of the page.
#[derive(Debug, Deserialize)]
#[serde(tag = "do", rename_all = "kebab-case")]
enum Request {
    /// Runs a line of a script.
    Run {
        /// The line.
        line: String,
    },
    /// Detects the features that edits share.
    Prepare {
        /// The name of the mesh.
        mesh: PathBuf,
        /// The name of the image.
        image: PathBuf,
    },
    /// Undoes the last action.
    Undo,
    /// Does again what was undone last.
    Redo,
    /// Writes a mesh to the file of its name.
    Write {
        /// The name of the mesh.
        mesh: PathBuf,
    },
}

fn main() {}

/// Answers the request on standard input.
// SAFETY: no other function of the module has this name.
#[allow(unsafe_code)]
#[unsafe(no_mangle)]
pub extern "C" fn answer_request() {
    let mut text = String::new();
    let reply = match stdin().lock().read_to_string(&mut text) {
        Ok(_) => WORKBENCH.with_borrow_mut(|workbench| Reply::new(workbench, &text)),
        Err(error) => Reply::error(error.to_string()),
    };
    if let Err(error) = reply.write() {
        print_stderr(format_args!("error: standard output: {error}"));
    }
}

/// The reply to a request: a JSON text, and the numbers of the arrays that it lists.
#[derive(Debug, Default)]
struct Reply {
    json: Map<String, Value>,
    arrays: Vec<Value>,
    bytes: Vec<u8>,
}

impl Reply {
    /// Carries out a request.
    fn new(workbench: &mut Workbench, text: &str) -> Self {
        let request: Request = match serde_json::from_str(text) {
            Ok(request) => request,
            Err(error) => return Self::error(format!("request: {error}; report this error")),
        };
        let mut reply = Self::default();
        match request {
            Request::Run { line } => match with_console(|p| run_line(workbench, &line, p)) {
                Ok((answer, patch)) => {
                    reply.set("text", answer.text);
                    reply.set("report", answer.json);
                    reply.set("files", answer.files);
                    reply.add_patch(patch.as_ref());
                }
                Err(error) => reply = Self::error(error_line(&error)),
            },
            Request::Prepare { mesh, image } => {
                let prepared = with_console(|p| workbench.prepare_edits(&mesh, &image, p));
                if let Err(error) = prepared {
                    reply = Self::error(error_line(&error));
                }
            }
            Request::Undo => reply.add_patch(workbench.undo().as_ref()),
            Request::Redo => reply.add_patch(workbench.redo().as_ref()),
            Request::Write { mesh } => match workbench.mesh(&mesh).map(|file| file.write(&mesh)) {
                Some(Ok(())) => {}
                Some(Err(error)) => reply = Self::error(error_line(&error)),
                None => {
                    let remedy = "make it first";
                    reply = Self::error(format!("{}: is not in memory; {remedy}", mesh.display()));
                }
            },
        }
        reply.set("done", workbench.done().collect::<Vec<_>>());
        reply.set("undone", workbench.undone().collect::<Vec<_>>());
        reply
    }

    fn error(message: String) -> Self {
        let mut reply = Self::default();
        reply.set("error", message);
        reply
    }

    fn set(&mut self, key: &str, value: impl Into<Value>) {
        self.json.insert(key.into(), value.into());
    }

    /// Adds what changed.
    fn add_patch(&mut self, patch: Option<&MeshPatch>) {
        let Some(patch) = patch else {
            return;
        };
        let mut json = patch.to_json();
        json["dimensions"] = patch.dimensions.into();
        json["cell_arrays"] = json!(patch.cell_array_names);
        json["node_arrays"] = json!(patch.node_array_names);
        self.set("patch", json);
        self.add_array("nodes", "u32", &patch.nodes, |n| n.to_le_bytes());
        self.add_array("positions", "f64", &patch.positions, |x| x.to_le_bytes());
        self.add_array("cells", "u32", &patch.cells, |c| c.to_le_bytes());
        self.add_array("corners", "u32", &patch.corners, |n| n.to_le_bytes());
        self.add_arrays("cell", &patch.cell_arrays);
        self.add_arrays("node", &patch.node_arrays);
    }

    fn add_arrays(&mut self, owner: &str, arrays: &[ArrayPatch]) {
        for ArrayPatch {
            name,
            indices,
            values,
            ..
        } in arrays
        {
            self.add_array(&format!("{owner} indices {name}"), "u32", indices, |i| {
                i.to_le_bytes()
            });
            self.add_array(&format!("{owner} values {name}"), "f32", values, |v| {
                v.to_le_bytes()
            });
        }
    }

    /// Adds an array, whose first byte is at a multiple of eight.
    fn add_array<T: Copy, const N: usize>(
        &mut self,
        name: &str,
        kind: &str,
        values: &[T],
        to_bytes: impl Fn(T) -> [u8; N],
    ) {
        let start = self.bytes.len().next_multiple_of(8);
        self.bytes.resize(start, 0);
        self.bytes.reserve(N * values.len());
        for &value in values {
            self.bytes.extend(to_bytes(value));
        }
        self.arrays.push(json!([name, kind, start, values.len()]));
    }

    /// Writes the reply to standard output.
    fn write(mut self) -> std::io::Result<()> {
        let arrays = std::mem::take(&mut self.arrays);
        self.set("arrays", arrays);
        let text = Value::from(self.json).to_string();
        let mut out = stdout().lock();
        out.write_all(&(text.len() as u32).to_le_bytes())?;
        out.write_all(text.as_bytes())?;
        out.write_all(&self.bytes)?;
        out.flush()
    }
}
