"""C code by which MuJoCo simulates wires of laws that MJCF cannot express."""

import casadi as ca

from limb_systems.limb_parameters import LimbParameters, ParameterError

# Registers nothing by itself: ctypes hands `wire_rates` to mujoco.set_mjcb_act_dyn, and
# `wire_torque` to mujoco.set_mjcb_act_bias. The wire's number is in the actuator's dynprm.
_CALLBACKS = """
#include <mujoco/mujoco.h>

typedef int (*wire_function)(const double**, double**, long long*, double*, int);
static const wire_function rates_of[] = {{{rates}}};
static const wire_function torque_of[] = {{{torques}}};

static double* evaluate(const wire_function* functions, const mjModel* model, const mjData* data,
                        int id, double* result) {{
  const double* arguments[] = {{data->act + model->actuator_actadr[id],
                               data->ctrl + model->actuator_ctrladr[id]}};
  double* results[] = {{result}};
  long long indices[{indices}];
  double work[{work}];
  functions[(int)model->actuator_dynprm[mjNDYN*id]](arguments, results, indices, work, 0);
  return result;
}}

mjtNum wire_rates(const mjModel* model, const mjData* data, int id) {{
  evaluate(rates_of, model, data, id, data->act_dot + model->actuator_actadr[id]);
  return 0;
}}

mjtNum wire_torque(const mjModel* model, const mjData* data, int id) {{
  double torque;
  return *evaluate(torque_of, model, data, id, &torque);
}}
"""


def wire_callback(parameters: LimbParameters) -> str:
    """Return C code for MuJoCo's callbacks, for the wires of `urdf.limb_mjcf` with ``callback``.

    A wire's activations are its law's states and its reading, [x, V], minus their cold values.

    Raises:
        ParameterError: if the torque of a law depends on the angle of the joint.
    """
    code = ca.CodeGenerator("wires", {"casadi_int": "long long int"})
    ambient = parameters.ambient_temperature
    functions = []
    for index, (wire, name) in enumerate(zip(parameters.wires, parameters.wire_names, strict=True)):
        # State rates and torque in symbols.
        law = wire.law
        cold = [*law.cold_states(ambient), ambient]
        act = ca.SX.sym("act", len(cold))
        duty = ca.SX.sym("duty")
        angle = ca.SX.sym("angle")
        *states, reading = ca.vertsplit(act + ca.DM(cold))
        rates = ca.vertcat(*law.rates(states, duty, ambient), law.reading_rate(reading, states))
        torque = ca.SX(law.torque(states, ambient, angle))
        if ca.depends_on(torque, angle):
            raise ParameterError(
                f"The torque of the wire {name} depends on the angle of the joint, which MuJoCo "
                "does not hand to an actuator; apply it at the joints."
            )
        # Generate their code.
        for kind, value in (("rates", rates), ("torque", torque)):
            functions.append(ca.Function(f"{kind}_{index}", [act, duty], [value]))
            code.add(functions[-1])
    names = [function.name() for function in functions]
    glue = _CALLBACKS.format(
        rates=", ".join(names[::2]),
        torques=", ".join(names[1::2]),
        indices=max(1, *(function.sz_iw() for function in functions)),
        work=max(1, *(function.sz_w() for function in functions)),
    )
    return code.dump() + glue
