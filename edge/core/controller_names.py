"""The public names of all controllers; the paper's are among them."""

from dataclasses import dataclass

RULES, PID, EXTERNAL = "rules", "PID", "external"
AUTO = "auto"  # the best that the rig's models allow
MPC = ("MPC", "MPC-P", "MPC-BFGS", "MPC-BFGS-P")
MPC_TWIN = ("MPC-Twin", "MPC-Twin-P")  # plan with the twin of a bundle
RL = ("RL-Off", "RL-Off-P", "RL-On-P", "RL-Tr-P")


@dataclass(frozen=True, slots=True)
class LlmVariant:
    """The inputs and tools of a controlling language model.

    assistance : "" none, "sql" the history, else the predictor whose simulations it may ask for
    temperature : of the sampling
    penalty : the prompt asks it to spare heater and fan
    """

    assistance: str
    temperature: float
    penalty: bool


LLM = {
    "LLM-Te0": LlmVariant("", 0.0, False),
    "LLM-Te0-P": LlmVariant("", 0.0, True),
    "LLM-SQL-Te0": LlmVariant("sql", 0.0, False),
    "LLM-SQL-Te1": LlmVariant("sql", 1.0, False),
    "LLM-SQL-Te0-P": LlmVariant("sql", 0.0, True),
    "LLM-Linear-Te0": LlmVariant("arx", 0.0, False),
    "LLM-Linear-Te0-P": LlmVariant("arx", 0.0, True),
    "LLM-LSTM-Te0": LlmVariant("lstm", 0.0, False),
    "LLM-LSTM-Te0-P": LlmVariant("lstm", 0.0, True),
    "LLM-HAM-Te0": LlmVariant("ham", 0.0, False),
    "LLM-HAM-Te0-P": LlmVariant("ham", 0.0, True),
}

CONTROLLERS = (RULES, PID, *MPC, *MPC_TWIN, *RL, *LLM, EXTERNAL)
# A model of the air temperature for the rig's step; a policy and a language model bring what they know.
NEED_A_MODEL = (
    *MPC,
    *MPC_TWIN,
    *(name for name, variant in LLM.items() if variant.assistance not in ("", "sql")),
)
NEED_NO_MODEL = tuple(name for name in CONTROLLERS if name not in NEED_A_MODEL)
