/* The drive of machine.py: rates of its states, and Runge-Kutta 4. The constants come from machine.py, as macros.

   States: fluxes of two stator axes and of the shorted turns, of the BARS modes of the cage; angle and mechanical speed
   of the rotor; of the speed control halfway, smooth, integral; of the current control flux (2), wanted, integrals (2);
   voltages (2) in axes linked to the rotor, as all of the control. */
#include <math.h>

struct windings {
  const double (*inductance)[3], (*resistance)[3], (*axes)[2];
  const double (*coupling)[BARS], *decay;
};

/* Rates of everything behind angle and speed. */
static void control(const double *x, double ids, double iqs, double reference, double *rates) {
  double speed = x[1], halfway = x[2], smooth = x[3], integral = x[4], fluxd = x[5], fluxq = x[6], wanted = x[7];
  double unlimited = GAIN * (smooth - speed) + integral;
  double torque = fmax(-TORQUE_MAX, fmin(TORQUE_MAX, unlimited));
  rates[2] = (reference - halfway) / SMOOTHING;
  rates[3] = (halfway - smooth) / SMOOTHING;
  rates[4] = (GAIN * (smooth - speed) + torque - unlimited) / INTEGRAL_TIME;
  rates[5] = KNOWN_RR * (ids - fluxd / KNOWN_LM);
  rates[6] = KNOWN_RR * (iqs - fluxq / KNOWN_LM);
  double flux = sqrt(fluxd * fluxd + fluxq * fluxq), c = fluxd / flux, s = fluxq / flux;
  double along = c * ids + s * iqs, across = c * iqs - s * ids;
  rates[7] = (fmin(CURRENT_MAX, FLUX / KNOWN_LM + FLUX_GAIN * (FLUX - flux)) - wanted) / MAGNETISING_TIME;
  double ef = wanted - along, et = torque / (POLE_PAIRS * FLUX) - across;
  double turning = POLE_PAIRS * speed + KNOWN_RR * across / fmax(flux, FLUX / 2);
  double uf = KNOWN_LF / CURRENT_TIME * ef + x[8] - turning * KNOWN_LF * across;
  double ut = KNOWN_LF / CURRENT_TIME * et + x[9] + turning * (KNOWN_LF * along + flux);
  double share = VOLTAGE_MAX / fmax(VOLTAGE_MAX, sqrt(uf * uf + ut * ut));
  rates[8] = ((KNOWN_RS + KNOWN_RR) * ef + (share - 1) * uf) / CURRENT_TIME;
  rates[9] = ((KNOWN_RS + KNOWN_RR) * et + (share - 1) * ut) / CURRENT_TIME;
  rates[10] = (share * (c * uf - s * ut) - x[10]) / INVERTER_TIME;
  rates[11] = (share * (s * uf + c * ut) - x[11]) / INVERTER_TIME;
}

/* Solve a (3, 3, symmetric and positive definite) y = b; both are lost, b becomes y. */
static void solve(double a[3][3], double b[3]) {
  for (int i = 0; i < 3; ++i)
    for (int j = i + 1; j < 3; ++j) {
      double factor = a[j][i] / a[i][i];
      for (int k = i; k < 3; ++k) a[j][k] -= factor * a[i][k];
      b[j] -= factor * b[i];
    }
  for (int i = 2; i >= 0; --i) {
    for (int k = i + 1; k < 3; ++k) b[i] -= a[i][k] * b[k];
    b[i] /= a[i][i];
  }
}

/* Rates of all states; the currents ids, iqs. */
void slope(const double *x, double reference, const struct windings *w, double *rates, double *currents) {
  const double *modes = x + 3, *rest = x + FLUXES;
  double c = cos(rest[0]), s = sin(rest[0]), ud = rest[10], uq = rest[11];
  double linked[2] = {0, 0}, reduction[2][2] = {{0, 0}, {0, 0}}; /* by the modes, without stator currents; with them */
  for (int a = 0; a < 2; ++a)
    for (int k = 0; k < BARS; ++k) {
      linked[a] += w->coupling[a][k] * modes[k];
      for (int b = 0; b < 2; ++b) reduction[a][b] += w->coupling[a][k] * w->coupling[b][k];
    }
  double turned[3][2], reduced[3][3], i[3]; /* turned: the stator's turns along axes linked to the rotor */
  for (int j = 0; j < 3; ++j) {
    turned[j][0] = c * w->axes[j][0] + s * w->axes[j][1];
    turned[j][1] = c * w->axes[j][1] - s * w->axes[j][0];
  }
  for (int j = 0; j < 3; ++j) {
    i[j] = x[j];
    for (int a = 0; a < 2; ++a) i[j] -= turned[j][a] * linked[a];
    for (int k = 0; k < 3; ++k) {
      reduced[j][k] = w->inductance[j][k];
      for (int a = 0; a < 2; ++a)
        for (int b = 0; b < 2; ++b) reduced[j][k] -= turned[j][a] * reduction[a][b] * turned[k][b];
    }
  }
  solve(reduced, i);
  double along[2] = {0, 0}, field[2] = {linked[0], linked[1]};
  for (int a = 0; a < 2; ++a)
    for (int j = 0; j < 3; ++j) along[a] += turned[j][a] * i[j];
  for (int a = 0; a < 2; ++a) field[a] -= reduction[a][0] * along[0] + reduction[a][1] * along[1];
  for (int j = 0; j < 3; ++j) {
    rates[j] = 0;
    for (int k = 0; k < 3; ++k) rates[j] -= w->resistance[j][k] * i[k];
  }
  rates[0] += c * ud - s * uq;
  rates[1] += s * ud + c * uq;
  for (int k = 0; k < BARS; ++k) /* what decays is the current of the mode */
    rates[3 + k] = -w->decay[k] * (modes[k] - w->coupling[0][k] * along[0] - w->coupling[1][k] * along[1]);
  double torque = POLE_PAIRS * (field[0] * along[1] - field[1] * along[0]);
  rates[FLUXES] = POLE_PAIRS * rest[1];
  rates[FLUXES + 1] = (torque - LOAD * rest[1]) / INERTIA;
  currents[0] = c * i[0] + s * i[1];
  currents[1] = c * i[1] - s * i[0];
  control(rest, currents[0], currents[1], reference, rates + FLUXES);
}

/* Voltages, electrical speed, angle and currents at every sample, found (count, 6); references (count) are held. */
void integrate(double *x, const double *references, int count, double h, int substeps, const struct windings *w,
               double *found) {
  double one[STATES], two[STATES], three[STATES], four[STATES], at[STATES], none[2];
  for (int k = 0; k < count; ++k, found += 6) {
    const double *rest = x + FLUXES;
    slope(x, references[k], w, one, found + 4);
    found[0] = rest[10], found[1] = rest[11], found[2] = POLE_PAIRS * rest[1], found[3] = rest[0];
    for (int step = 0; step < substeps; ++step) {
      slope(x, references[k], w, one, none);
      for (int i = 0; i < STATES; ++i) at[i] = x[i] + h / 2 * one[i];
      slope(at, references[k], w, two, none);
      for (int i = 0; i < STATES; ++i) at[i] = x[i] + h / 2 * two[i];
      slope(at, references[k], w, three, none);
      for (int i = 0; i < STATES; ++i) at[i] = x[i] + h * three[i];
      slope(at, references[k], w, four, none);
      for (int i = 0; i < STATES; ++i) x[i] += h / 6 * (one[i] + 2 * two[i] + 2 * three[i] + four[i]);
    }
  }
}
