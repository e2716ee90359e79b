use super::file::ConfigFile;
use super::keys::{CONFIG, Key, Kind, OWNER, keys, with_open_switches};
use super::layers::Asked;
use super::*;
use crate::cli::Cli;
use clap::{Args, CommandFactory, FromArgMatches, Parser};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

/// A program with a setting of each kind, and two that cannot be used together.
#[derive(Parser)]
enum Toy {
    Serve(Serve),
    Shoot {
        session: PathBuf,
        #[command(flatten)]
        common: Common,
        #[arg(long)]
        pairs: Option<u32>,
    },
}

#[derive(Args)]
struct Common {
    #[arg(long, conflicts_with = "camera")]
    studio: bool,
    #[arg(long)]
    camera: Option<String>,
    #[arg(long)]
    config: Option<PathBuf>,
}

#[derive(Args)]
struct Serve {
    #[command(flatten)]
    common: Common,
    #[arg(long, default_value_t = 8710)]
    port: u16,
    #[arg(long, requires = "port_file")]
    allow_host: Vec<String>,
    #[arg(long)]
    port_file: Option<PathBuf>,
}

fn toy() -> Command {
    with_open_switches(Toy::command())
}

fn layered(toml: &str, environment: &[(&str, &str)], words: &[&str]) -> Result<Settled, SettingsError> {
    let command = toy();
    let arguments: Vec<OsString> = ["unlit"].iter().chain(words).map(OsString::from).collect();
    let environment: Vec<(OsString, OsString)> =
        environment.iter().map(|(name, value)| (name.into(), value.into())).collect();
    let file = ConfigFile { path: "/etc/toy.toml".into(), text: toml.to_owned() };
    Asked::new(&command, &arguments).unwrap().settle(Some(&file), &environment)
}

/// What the program gets to see of it.
fn in_force(toml: &str, environment: &[(&str, &str)], words: &[&str]) -> Result<Toy, String> {
    let settled = layered(toml, environment, words).map_err(|error| error.to_string())?;
    let matches = toy().try_get_matches_from(&settled.arguments).map_err(|error| {
        let origins = settled.explain(&error);
        format!("{error}{}", origins.join("\n"))
    })?;
    Ok(Toy::from_arg_matches(&matches).unwrap())
}

fn serve(toml: &str, environment: &[(&str, &str)], words: &[&str]) -> Serve {
    match in_force(toml, environment, &[&["serve"], words].concat()).unwrap() {
        Toy::Serve(serve) => serve,
        Toy::Shoot { .. } => panic!("asked for serve"),
    }
}

#[test]
fn a_value_comes_from_the_highest_layer_that_has_it() {
    assert_eq!(serve("", &[], &[]).port, 8710);
    assert_eq!(serve("port = 1", &[], &[]).port, 1);
    assert_eq!(serve("port = 1", &[("UNLIT_PORT", "2")], &[]).port, 2);
    assert_eq!(serve("port = 1", &[("UNLIT_PORT", "2")], &["--port", "3"]).port, 3);
    assert_eq!(serve("port = '4'", &[("UNLIT_PORT", "")], &[]).port, 4, "an empty variable says nothing");
}

#[test]
fn a_switch_is_turned_on_and_off_by_every_layer() {
    assert!(serve("studio = true", &[], &[]).common.studio);
    for (variable, on) in [("no", false), ("0", false), ("yes", true), ("true", true)] {
        assert_eq!(serve("studio = true", &[("UNLIT_STUDIO", variable)], &[]).common.studio, on);
        assert_eq!(serve("", &[("UNLIT_STUDIO", variable)], &[]).common.studio, on);
        assert!(serve("", &[("UNLIT_STUDIO", variable)], &["--studio"]).common.studio);
        assert!(!serve("", &[("UNLIT_STUDIO", variable)], &["--studio=false"]).common.studio);
    }
}

#[test]
fn a_list_is_replaced_whole() {
    let file = "allow-host = ['a', 'b']\nport-file = 'p'";
    let hosts = |variable: &[(&str, &str)], words: &[&str]| serve(file, variable, words).allow_host;
    assert_eq!(hosts(&[], &[]), ["a", "b"]);
    assert_eq!(hosts(&[("UNLIT_ALLOW_HOST", "c, d")], &[]), ["c", "d"]);
    assert_eq!(hosts(&[("UNLIT_ALLOW_HOST", "c")], &["--allow-host", "e", "--allow-host=f"]), ["e", "f"]);
    assert!(serve("allow-host = []", &[], &[]).allow_host.is_empty());
}

#[test]
fn a_higher_layer_puts_aside_what_it_cannot_be_used_with() {
    let flag = serve("studio = true", &[], &["--camera", "usb:1"]).common;
    assert_eq!((flag.studio, flag.camera.as_deref()), (false, Some("usb:1")));
    let flag = serve("camera = 'usb:1'", &[], &["--studio"]).common;
    assert_eq!((flag.studio, flag.camera), (true, None));
    let off = serve("camera = 'usb:1'", &[("UNLIT_STUDIO", "no")], &["--studio=false"]).common;
    assert_eq!((off.studio, off.camera.as_deref()), (false, Some("usb:1")));
    let both = in_force("studio = true\ncamera = 'usb:1'", &[], &["serve"]).err().unwrap();
    assert!(both.contains("cannot be used with"), "{both}");
    assert!(both.contains("--camera comes from /etc/toy.toml, line 2"), "{both}");
}

#[test]
fn what_requires_something_finds_it_in_any_layer() {
    let hosts = serve("port-file = 'p'", &[], &["--allow-host", "a"]).allow_host;
    assert_eq!(hosts, ["a"]);
    let alone = in_force("allow-host = ['a']", &[], &["serve"]).err().unwrap();
    assert!(alone.contains("--port-file"), "{alone}");
}

#[test]
fn other_commands_take_what_they_share_with_serve() {
    let toml = "port = 7\ncamera = 'usb:2'";
    let environment = [("UNLIT_PAIRS", "9"), ("UNLIT_PORT_FILE", "p")];
    let Toy::Shoot { session, common, pairs } = in_force(toml, &environment, &["shoot", "vase"]).unwrap()
    else {
        panic!("asked for shoot")
    };
    assert_eq!((session, common.camera.as_deref(), pairs), (PathBuf::from("vase"), Some("usb:2"), None));
}

#[test]
fn what_is_wrong_is_told_with_its_place_and_what_to_do() {
    for (toml, environment, expected) in [
        (
            "\n\nprot = 1",
            [].as_slice(),
            "/etc/toy.toml, line 3: there is no setting `prot` (did you mean `port`?); \
          the settings are studio, camera, port, allow-host, port-file",
        ),
        ("port_file = 'x'", &[], "(did you mean `port-file`?)"),
        ("pairs = 3", &[], "there is no setting `pairs`; the settings"),
        ("config = 'x'", &[], "there is no setting `config`; the settings"),
        ("[serve]\nport = 1", &[], "line 1: there is no setting `serve`"),
        (
            "port = [1]",
            &[],
            "/etc/toy.toml, line 1: `port` must be a text in quotes, or a number (found: array)",
        ),
        ("studio = 'yes'", &[], "`studio` must be true or false (found: string)"),
        ("allow-host = 'a'", &[], "`allow-host` must be a list of texts in brackets (found: string)"),
        ("port = 70000", &[], "line 1: `port`: invalid value '70000' for '--port <PORT>'"),
        ("port = ", &[], "/etc/toy.toml, line 1: this is no TOML"),
        ("", &[("UNLIT_PORT", "x")], "UNLIT_PORT in the environment: `port`: invalid value 'x'"),
        (
            "",
            &[("UNLIT_STUDIO", "maybe")],
            "UNLIT_STUDIO in the environment: `studio`: invalid value 'maybe'",
        ),
    ] {
        let told = in_force(toml, environment, &["serve"]).err().unwrap_or_default();
        assert!(told.contains(expected), "{toml} {environment:?}: {told}");
    }
}

#[test]
fn a_variable_that_looks_mistyped_is_named() {
    let environment = [("UNLIT_PROT", "1"), ("UNLIT_LOG", "debug"), ("UNLIT_XYZ", "1"), ("UNLIT_PORT", "1")];
    let doubts = layered("", &environment, &["serve"]).unwrap().doubts;
    assert_eq!(doubts, ["UNLIT_PROT in the environment is read by nothing; UNLIT_PORT is a setting"]);
}

#[test]
fn what_is_printed_says_where_it_comes_from_and_is_a_config_file() {
    let toml = "allow-host = ['a', 'b']\nport-file = 'a\"b'";
    let environment = [("UNLIT_PORT", "2"), ("UNLIT_STUDIO", "0")];
    let first = layered(toml, &environment, &["serve", "--camera=c"]).unwrap();
    let expected = "# config file: /etc/toy.toml\n\
                    studio = false  # UNLIT_STUDIO in the environment\n\
                    camera = \"c\"  # flag\n\
                    port = \"2\"  # UNLIT_PORT in the environment\n\
                    allow-host = [\"a\", \"b\"]  # /etc/toy.toml, line 1\n\
                    port-file = \"a\\\"b\"  # /etc/toy.toml, line 2\n";
    assert_eq!(first.words(), expected);
    let again = serve(&first.words(), &[], &[]);
    assert_eq!((again.port, again.common.camera.as_deref()), (2, Some("c")));
    assert!(layered("", &[], &["serve"]).unwrap().words().contains("# camera is not set\n"));
}

#[test]
fn the_named_file_must_be_there_and_the_usual_ones_need_not() {
    let folder = tempfile::tempdir().unwrap();
    let home = [("XDG_CONFIG_HOME".into(), folder.path().into())];
    let own = folder.path().join("unlit/config.toml");
    let found = |named: Option<&Path>| file::find(named.map(Path::as_os_str), &home);
    assert!(found(None).unwrap().is_none_or(|file| file.path != own));
    std::fs::create_dir(folder.path().join("unlit")).unwrap();
    std::fs::write(&own, "port = 1").unwrap();
    assert_eq!(found(None).unwrap().unwrap().path, own);
    let missing = found(Some(&folder.path().join("none.toml"))).unwrap_err().to_string();
    assert!(missing.contains("none.toml cannot be read"), "{missing}");
    assert_eq!(found(Some(Path::new("/dev/null"))).unwrap().unwrap().text, "");
    std::fs::set_permissions(&own, std::fs::Permissions::from_mode(0o646)).unwrap();
    let anybody = found(None).unwrap_err().to_string();
    assert!(anybody.contains("chmod o-w"), "{anybody}");
}

fn of_serve() -> Vec<Key> {
    let command = with_open_switches(Cli::command());
    keys(command.find_subcommand(OWNER).unwrap())
}

/// A value that clap takes for a flag that it does not know better.
fn some_value(command: &Command, key: &Key) -> String {
    let candidates = ["true", "127.0.0.1:1", "50", "1", "0.5", "human", "usb:1"];
    let takes = |value: &&&str| {
        let words = ["unlit".to_owned(), format!("--{}={value}", key.name)];
        !command.clone().try_get_matches_from(words).is_err_and(|error| {
            !matches!(error.kind(), ErrorKind::MissingRequiredArgument | ErrorKind::ArgumentConflict)
        })
    };
    (*candidates.iter().find(takes).unwrap_or_else(|| panic!("add a value that --{} takes", key.name)))
        .to_owned()
}

#[test]
fn every_flag_of_serve_is_set_by_file_environment_and_flag() {
    let root = with_open_switches(Cli::command());
    let command = root.find_subcommand(OWNER).unwrap();
    let settable = command.get_arguments().filter_map(|flag| flag.get_long());
    let settable: Vec<&str> = settable.filter(|name| !["config", "print-config"].contains(name)).collect();
    let known = of_serve();
    assert_eq!(known.iter().map(|key| key.name.as_str()).collect::<Vec<_>>(), settable);
    assert!(known.len() >= 9, "{settable:?}");
    for key in &known {
        let value = some_value(command, key);
        let toml = match key.kind {
            Kind::Switch => format!("{} = {value}", key.name),
            Kind::Value => format!("{} = '{value}'", key.name),
            Kind::List => format!("{} = ['{value}']", key.name),
        };
        let origin = |toml: &str, environment: &[(OsString, OsString)], flag: Option<String>| {
            let words = ["unlit".to_owned(), OWNER.to_owned()].into_iter().chain(flag);
            let arguments: Vec<OsString> = words.map(OsString::from).collect();
            let file = ConfigFile { path: "f".into(), text: toml.to_owned() };
            let settled = Asked::new(&root, &arguments).unwrap().settle(Some(&file), environment).unwrap();
            let setting = settled.settings.into_iter().find(|s| s.name == key.name).unwrap();
            (setting.values == [OsString::from(&value)]).then_some(setting.origin)
        };
        let variable = [(OsString::from(key.variable()), OsString::from(&value))];
        let flag = format!("--{}={value}", key.name);
        assert_eq!(origin(&toml, &[], None), Some(Origin::File { path: "f".into(), line: 1 }), "{key:?}");
        assert_eq!(origin(&toml, &variable, None), Some(Origin::Environment(key.variable())), "{key:?}");
        assert_eq!(origin(&toml, &variable, Some(flag)), Some(Origin::Flag), "{key:?}");
    }
}

/// Every command that takes settings, and those below it.
fn takers(command: &Command) -> Vec<&Command> {
    let own = command.get_arguments().any(|flag| flag.get_id() == CONFIG).then_some(command);
    own.into_iter().chain(command.get_subcommands().flat_map(takers)).collect()
}

#[test]
fn a_setting_is_of_one_kind_in_every_command() {
    let root = with_open_switches(Cli::command());
    let takers = takers(&root);
    let names: Vec<&str> = takers.iter().map(|command| command.get_name()).collect();
    assert_eq!(names, ["serve", "shoot", "repeatability"]);
    let serve = of_serve();
    for key in takers.into_iter().flat_map(keys) {
        if let Some(same) = serve.iter().find(|k| k.name == key.name) {
            assert_eq!((same.kind, &same.default), (key.kind, &key.default), "{}", key.name);
        }
    }
}

#[test]
fn the_manual_lists_every_setting() {
    let root = with_open_switches(Cli::command());
    let command = root.find_subcommand(OWNER).unwrap();
    let mut table = String::from("| key and flag | variable | default | what it is |\n|---|---|---|---|\n");
    for key in of_serve() {
        let flag = command.get_arguments().find(|flag| *flag.get_id() == key.id).unwrap();
        let help = flag.get_help().map(ToString::to_string).unwrap_or_default().replace('|', "\\|");
        let default: Vec<_> = key.default.iter().map(|v| format!("`{}`", v.to_string_lossy())).collect();
        table += &format!("| `{}` | `{}` | {} | {help} |\n", key.name, key.variable(), default.join(" "));
    }
    let manual = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/configuration.md");
    let text = std::fs::read_to_string(&manual).unwrap();
    assert!(text.contains(&table), "docs/configuration.md must hold this table of the settings:\n{table}");
}
