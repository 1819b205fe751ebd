//! Questions to the user: in a terminal, or without one.

use std::io::{self, BufRead, Write};

/// Why an answer could not be had.
#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    /// There is no terminal.
    #[error("setup asks in a terminal; without one it needs {0}")]
    NoTerminal(String),
    /// The terminal has gone away.
    #[error("the terminal: {0}")]
    Terminal(#[from] io::Error),
}

/// Somebody who answers.
pub trait Questions {
    /// Asks for what `option` gives, until `take` is content with it. An empty answer stands for `usual`.
    ///
    /// # Errors
    /// Without an answer.
    fn ask(
        &mut self,
        option: &str,
        question: &str,
        usual: &str,
        take: &mut dyn FnMut(&str) -> Result<(), String>,
    ) -> Result<(), SetupError>;

    /// Whether there is a terminal; questions with a default are asked only then.
    fn is_interactive(&self) -> bool {
        true
    }

    /// After the last question: what could not be asked.
    ///
    /// # Errors
    /// When there was a question and no terminal.
    fn finish(&self) -> Result<(), SetupError> {
        Ok(())
    }
}

/// Asks in a terminal.
pub struct TerminalQuestions<R, W> {
    /// What is typed.
    pub input: R,
    /// What is shown.
    pub output: W,
}

impl<R: BufRead, W: Write> Questions for TerminalQuestions<R, W> {
    fn ask(
        &mut self,
        _option: &str,
        question: &str,
        usual: &str,
        take: &mut dyn FnMut(&str) -> Result<(), String>,
    ) -> Result<(), SetupError> {
        loop {
            write!(self.output, "{question} [{usual}] ")?;
            self.output.flush()?;
            let mut line = String::new();
            if self.input.read_line(&mut line)? == 0 {
                return Err(SetupError::Terminal(io::ErrorKind::UnexpectedEof.into()));
            }
            let answer = if line.trim().is_empty() { usual } else { line.trim() };
            match take(answer) {
                Ok(()) => return Ok(()),
                Err(why) => writeln!(self.output, "  {answer}: {why}")?,
            }
        }
    }
}

/// Nobody is there: what would be asked is collected, to be named all at once.
#[derive(Default)]
pub struct NoTerminal {
    missing: Vec<String>,
}

impl Questions for NoTerminal {
    fn ask(
        &mut self,
        option: &str,
        _question: &str,
        usual: &str,
        take: &mut dyn FnMut(&str) -> Result<(), String>,
    ) -> Result<(), SetupError> {
        self.missing.push(option.to_owned());
        // Further questions may hang on the answer.
        let _ = take(usual);
        Ok(())
    }

    fn is_interactive(&self) -> bool {
        false
    }

    fn finish(&self) -> Result<(), SetupError> {
        if self.missing.is_empty() { Ok(()) } else { Err(SetupError::NoTerminal(self.missing.join(", "))) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_answer_is_the_usual_one_and_a_wrong_one_is_asked_again() {
        let (mut output, mut taken) = (Vec::new(), Vec::new());
        let mut terminal = TerminalQuestions { input: b"\nseven\n8\n".as_slice(), output: &mut output };
        for _ in 0..2 {
            let mut take = |text: &str| {
                let number: u32 = text.parse().map_err(|_| "not a number".to_owned())?;
                taken.push(number);
                Ok(())
            };
            terminal.ask("--n N", "how many?", "3", &mut take).unwrap();
        }
        let end = terminal.ask("--n N", "how many?", "3", &mut |_| Ok(()));
        assert!(matches!(end, Err(SetupError::Terminal(_))));
        assert_eq!(taken, [3, 8]);
        assert!(String::from_utf8(output).unwrap().contains("seven: not a number"));
    }

    #[test]
    fn without_a_terminal_all_missing_options_are_named_in_one_line() {
        let mut nobody = NoTerminal::default();
        assert!(nobody.finish().is_ok());
        for option in ["--robot NAME", "--mode map|localize"] {
            nobody.ask(option, "?", "x", &mut |_| Ok(())).unwrap();
        }
        let text = nobody.finish().unwrap_err().to_string();
        assert_eq!(text, "setup asks in a terminal; without one it needs --robot NAME, --mode map|localize");
    }
}
