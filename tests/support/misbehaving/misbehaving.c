/* An FMU for tests only: a first-order lag, T x' = gain u - x, exact where u is held over a step, that takes its
   process down with it, or ties it up, when told to. FMI 2.0 (-DFMI=2) and 3.0 (-DFMI=3), co-simulation and model
   exchange.

   It misbehaves in the way of `mode`, rounded, where bad_from <= gain <= bad_to: in the steps from the time `at` on, or
   in the call that `where` names. The token (GUID) can hold more words: "at-instantiation-<mode>"; "shared", with which
   the state stands outside the instances; and "alone", with which two threads in it at once are a fatal error, freeing
   one instance spoils all others, and so does making one with the other interface. MODES is the list of the modes, MARK
   that of the bytes with which messages of isolated processes begin; -DAT_LOADING=<mode> misbehaves when the library is
   loaded. */
#include <fenv.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>
#if FMI == 2
#include "fmi2Functions.h"
#define NAME(name) fmi2##name
#define STATUS fmi2Status
#define INSTANCE fmi2Component
#define REFERENCE fmi2ValueReference
#define FLAG fmi2Boolean
#else
#include "fmi3Functions.h"
#define NAME(name) fmi3##name
#define STATUS fmi3Status
#define INSTANCE fmi3Instance
#define REFERENCE fmi3ValueReference
#define FLAG fmi3Boolean
#endif

enum { MODES };
enum { OK = 0, STATUS_DISCARD = 2, STATUS_ERROR = 3, STATUS_FATAL = 4, NO_STATUS = 17 };
enum { IN_STEP, IN_INITIALIZATION, IN_RESET, IN_FREEING, IN_GETTING };
/* value references */
enum { GAIN, T, MODE, AT, BAD_FROM, BAD_TO, WHERE, AMOUNT, U, X, DX, N_REALS };
typedef struct {
  double r[N_REALS], time;
  int shared, done; /* done: what is done once a simulation */
  int alone, generation;
} Model;

static const long most = 2048; /* MB that it takes at most, so that a test that fails does no harm */
static double shared_state;
static int inside, generation, last_kind; /* of those that are alone */
static void *volatile sink;
static volatile unsigned long spins;
static const char noise[64] = "no message";
static const unsigned char forged[] = {MARK, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2, 3, 4, 0, 0, 0, 0, 0, 0, 0, 1};

static double *state(Model *m) { return m->shared ? &shared_state : m->r + X; }
static void set_defaults(Model *m) {
  memset(m->r, 0, sizeof m->r);
  m->r[GAIN] = m->r[T] = 1, m->r[AMOUNT] = 4, m->time = 0, m->done = 0;
  m->r[BAD_FROM] = -1e300, m->r[BAD_TO] = 1e300;
  *state(m) = 0;
}

/* ---- the ways to misbehave */

static void sleep_for_ever(void) { for (;;) sleep(1000); }
static void take(long megabytes) {
  static long taken = 0;
  if ((taken += megabytes) > most) sleep_for_ever();
  sink = memset(malloc((size_t)megabytes << 20), 1, (size_t)megabytes << 20);
}
static void share(long megabytes) {
  static long taken = 0;
  void *there = MAP_FAILED;
  if ((taken += megabytes) <= most)
    there = mmap(0, (size_t)megabytes << 20, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  if (there == MAP_FAILED) sleep_for_ever();
  memset(there, 1, (size_t)megabytes << 20);
}
static void brood(void) { /* all together take 480 MB */
  for (int i = 0; i < 4; i++)
    if (fork() == 0) alarm(60), take(120), sleep_for_ever();
  sleep_for_ever();
}
static void escape(void) {
  if (fork() == 0) {
    setsid();
    if (fork() == 0) alarm(60), sleep_for_ever();
    _exit(0);
  }
  wait(0);
}
static double deeper(double depth) {
  volatile double room[512];
  room[(int)depth % 512] = depth;
  return deeper(depth + 1) + room[0];
}
static void write_much(double megabytes) {
  for (double i = 0; i < megabytes * 1024; i++) {
    fprintf(stdout, "%-1023s\n", "a line on stdout");
    fprintf(stderr, "%-1023s\n", "a line on stderr");
  }
}
static double released(void) {
  const char *path = getenv(RELEASED);
  FILE *file = path ? fopen(path, "r") : 0;
  double number = 0;
  if (file && fscanf(file, "%lf", &number) != 1) number = 0;
  if (file) fclose(file);
  return number;
}
static void change_floats(int mode) {
  if (mode == ROUND_UPWARD) fesetround(FE_UPWARD);
#if defined(__x86_64__)
  const unsigned flush = 0x8040, divisions = 0x200; /* bits of MXCSR: flush to zero and denormals are zero; mask */
  const unsigned short trapping = 0x37b, precise = 0x27f; /* control words of x87 */
  unsigned csr = __builtin_ia32_stmxcsr();
  if (mode == FLUSH) __builtin_ia32_ldmxcsr(csr | flush);
  if (mode == TRAP) __builtin_ia32_ldmxcsr(csr & ~divisions);
  if (mode == TRAP) __asm__ volatile("fldcw %0" : : "m"(trapping));
  if (mode == LESS_PRECISE) __asm__ volatile("fldcw %0" : : "m"(precise));
#endif
}
static STATUS misbehave(int mode, double amount) {
  volatile int *nowhere = 0;
  sigset_t all;
  switch (mode) {
  case SEGFAULT: *nowhere = 1; break;
  case ABORT: abort();
  case ILLEGAL: raise(SIGILL); break;
  case DIVISION: raise(SIGFPE); break;
  case KILL: raise(SIGKILL); break;
  case EXIT_0: exit(0);
  case EXIT_3: exit(3);
  case DOUBLE_FREE: sink = malloc(64), free(sink), free(sink); break;
  case STACK: return deeper(1) > 0 ? OK : STATUS_ERROR;
  case CLOSE: for (int file = 0; file < 4096; file++) close(file); break;
  case LOOP: for (;;) spins++;
  case SLEEP: sleep_for_ever(); break;
  case STUBBORN:
    sigfillset(&all), sigprocmask(SIG_BLOCK, &all, 0);
    for (;;) spins++;
  case STOP: raise(SIGSTOP); break;
  case RUNAWAY: for (;;) take(4);
  case SLOW: usleep((useconds_t)(1000 * amount)); break;
  case LEAK: case LEAK_ONCE: take((long)amount); break;
  case RETURN_ERROR: return STATUS_ERROR;
  case RETURN_FATAL: return STATUS_FATAL;
  case RETURN_DISCARD: return STATUS_DISCARD;
  case RETURN_NONSENSE: return NO_STATUS;
  case SPEAK:
    printf("the FMU says on stdout: gain\n"), fprintf(stderr, "the FMU says on stderr: gain\n");
    break;
  case MUTTER: printf("no line of stdout"), fprintf(stderr, "no line of stderr"); break;
  case CHATTER: write_much(amount); break;
  case LATER: alarm(1); break; /* it is ended by SIGALRM when nobody uses it any more */
  case ROUND_UPWARD: case FLUSH: case TRAP: case LESS_PRECISE: change_floats(mode); break;
  case SPAWN: if (fork() == 0) alarm(60), sleep_for_ever(); break;
  case ESCAPE: escape(); break;
  case LIMIT: setrlimit(RLIMIT_AS, &(struct rlimit){1 << 20, 1 << 20}); break;
  case GARBLE:
    for (int file = 0; file < 4096; file++) send(file, noise, sizeof noise, MSG_DONTWAIT);
    sleep_for_ever();
  case FORGE:
    for (int file = 0; file < 4096; file++) send(file, forged, sizeof forged, MSG_DONTWAIT);
    sleep_for_ever();
  case RETURN_TWICE: if (fork() == 0) usleep((useconds_t)(1000 * amount)); break;
  case STOP_PARENT: kill(getppid(), SIGSTOP); break;
  case SHARE: for (;;) share(4), usleep(1000);
  case BROOD: brood(); break;
  case WAIT: while (released() < amount) usleep(1000); break;
  }
  return OK;
}
static int mode_of(const Model *m) {
  const int bad = m->r[BAD_FROM] <= m->r[GAIN] && m->r[GAIN] <= m->r[BAD_TO];
  return bad ? (int)lround(m->r[MODE]) : 0;
}
static STATUS where(const Model *m, int place) {
  return (int)lround(m->r[WHERE]) == place ? misbehave(mode_of(m), m->r[AMOUNT]) : OK;
}
static int due(const Model *m, double time) { return time >= m->r[AT] && (int)lround(m->r[WHERE]) == IN_STEP; }
static int is_nan(const Model *m, double time) { return due(m, time) && mode_of(m) == NOT_A_NUMBER; }
/* from `at` on, in every call; LEAK_ONCE and the modes after it only in the first one */
static STATUS within(Model *m, double time) {
  if (!due(m, time) || m->done) return OK;
  m->done = mode_of(m) >= LEAK_ONCE;
  return misbehave(mode_of(m), m->r[AMOUNT]);
}
#ifdef AT_LOADING
__attribute__((constructor)) static void load(void) { misbehave(AT_LOADING, 4); }
#endif

/* ---- both kinds */

static STATUS crowded(const Model *m) {
  if (!m->alone) return OK;
  const int others = __atomic_fetch_add(&inside, 1, __ATOMIC_SEQ_CST);
  usleep(20);
  __atomic_fetch_sub(&inside, 1, __ATOMIC_SEQ_CST);
  return others ? STATUS_FATAL : OK;
}
static double spoilt(const Model *m) { return m->alone && m->generation != generation; } /* its memory is gone */
static Model *make(const char *token, int kind) {
  const char *told = strstr(token, "at-instantiation-");
  Model *m;
  if (told) misbehave(atoi(told + strlen("at-instantiation-")), 4);
  m = malloc(sizeof *m);
  m->shared = strstr(token, "shared") != 0;
  m->alone = strstr(token, "alone") != 0;
  if (m->alone) generation += kind != last_kind, last_kind = kind;
  m->generation = generation;
  set_defaults(m);
  return m;
}
STATUS NAME(Reset)(INSTANCE c) {
  const STATUS status = where(c, IN_RESET);
  set_defaults(c);
  return status > crowded(c) ? status : crowded(c);
}
void NAME(FreeInstance)(INSTANCE c) {
  Model *m = c;
  where(m, IN_FREEING);
  generation += m->alone;
  free(m);
}
STATUS NAME(Terminate)(INSTANCE c) { (void)c; return OK; }
STATUS NAME(ExitInitializationMode)(INSTANCE c) { return where(c, IN_INITIALIZATION); }
static STATUS set(Model *m, const REFERENCE r[], size_t n, const double v[]) {
  for (size_t i = 0; i < n; i++) *(r[i] == X ? state(m) : m->r + r[i]) = v[i];
  return OK;
}
static STATUS derivative(Model *m, double *d) {
  *d = is_nan(m, m->time) ? NAN : (m->r[GAIN] * m->r[U] - *state(m)) / m->r[T];
  const STATUS status = crowded(m);
  return status ? status : within(m, m->time);
}
static STATUS get(Model *m, const REFERENCE r[], size_t n, double v[]) {
  for (size_t i = 0; i < n; i++) {
    if (r[i] == DX) derivative(m, v + i);
    else v[i] = r[i] == X ? *state(m) + spoilt(m) : m->r[r[i]];
  }
  return where(m, IN_GETTING);
}
static STATUS step(Model *m, double t, double h) {
  double *x = state(m);
  const double end = m->r[GAIN] * m->r[U];
  const STATUS status = within(m, t + h);
  *x = is_nan(m, t + h) ? NAN : end + (*x - end) * exp(-h / m->r[T]);
  m->time = t + h;
  const STATUS others = crowded(m);
  return others ? others : status;
}
STATUS NAME(SetTime)(INSTANCE c, double t) { ((Model *)c)->time = t; return OK; }
STATUS NAME(SetContinuousStates)(INSTANCE c, const double x[], size_t n) { return (void)n, *state(c) = *x, OK; }
STATUS NAME(GetContinuousStates)(INSTANCE c, double x[], size_t n) { return (void)n, *x = *state(c), OK; }
STATUS NAME(GetNominalsOfContinuousStates)(INSTANCE c, double x[], size_t n) { return (void)c, (void)n, *x = 1, OK; }
STATUS NAME(GetEventIndicators)(INSTANCE c, double z[], size_t n) { return (void)c, (void)z, (void)n, OK; }
STATUS NAME(EnterEventMode)(INSTANCE c) { (void)c; return OK; }
STATUS NAME(EnterContinuousTimeMode)(INSTANCE c) { (void)c; return OK; }
STATUS NAME(CompletedIntegratorStep)(INSTANCE c, FLAG none, FLAG *event, FLAG *terminate) {
  return (void)c, (void)none, *event = *terminate = 0, OK;
}

/* ---- what differs between the versions */

#if FMI == 2
INSTANCE fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String token, fmi2String resources,
                         const fmi2CallbackFunctions *callbacks, FLAG visible, FLAG logging) {
  (void)name, (void)resources, (void)callbacks, (void)visible, (void)logging;
  return make(token, type == fmi2CoSimulation);
}
STATUS fmi2SetupExperiment(INSTANCE c, FLAG tolerant, double tolerance, double start, FLAG stops, double stop) {
  return (void)tolerant, (void)tolerance, (void)stops, (void)stop, ((Model *)c)->time = start, OK;
}
STATUS fmi2EnterInitializationMode(INSTANCE c) { (void)c; return OK; }
STATUS fmi2SetDebugLogging(INSTANCE c, FLAG on, size_t n, const fmi2String k[]) {
  return (void)c, (void)on, (void)n, (void)k, OK;
}
STATUS fmi2SetReal(INSTANCE c, const REFERENCE r[], size_t n, const double v[]) { return set(c, r, n, v); }
STATUS fmi2GetReal(INSTANCE c, const REFERENCE r[], size_t n, double v[]) { return get(c, r, n, v); }
STATUS fmi2GetDerivatives(INSTANCE c, double d[], size_t n) { (void)n; return derivative(c, d); }
STATUS fmi2NewDiscreteStates(INSTANCE c, fmi2EventInfo *info) { return (void)c, memset(info, 0, sizeof *info), OK; }
STATUS fmi2DoStep(INSTANCE c, double t, double h, FLAG none) { (void)none; return step(c, t, h); }
#else
INSTANCE fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, FLAG visible,
                                     FLAG logging, FLAG events, FLAG early, const REFERENCE r[], size_t n,
                                     fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                     fmi3IntermediateUpdateCallback update) {
  (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early, (void)r, (void)n;
  return (void)environment, (void)log, (void)update, make(token, 1);
}
INSTANCE fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, FLAG visible,
                                      FLAG logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
  (void)name, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
  return make(token, 0);
}
STATUS fmi3EnterInitializationMode(INSTANCE c, FLAG tolerant, double tolerance, double start, FLAG stops, double stop) {
  return (void)tolerant, (void)tolerance, (void)stops, (void)stop, ((Model *)c)->time = start, OK;
}
STATUS fmi3SetDebugLogging(INSTANCE c, FLAG on, size_t n, const fmi3String k[]) {
  return (void)c, (void)on, (void)n, (void)k, OK;
}
STATUS fmi3SetFloat64(INSTANCE c, const REFERENCE r[], size_t n, const double v[], size_t k) {
  return (void)k, set(c, r, n, v);
}
STATUS fmi3GetFloat64(INSTANCE c, const REFERENCE r[], size_t n, double v[], size_t k) {
  return (void)k, get(c, r, n, v);
}
STATUS fmi3GetContinuousStateDerivatives(INSTANCE c, double d[], size_t n) { (void)n; return derivative(c, d); }
STATUS fmi3UpdateDiscreteStates(INSTANCE c, FLAG *needed, FLAG *ended, FLAG *nominals, FLAG *values, FLAG *defined,
                                double *next) {
  return (void)c, (void)next, *needed = *ended = *nominals = *values = *defined = 0, OK;
}
STATUS fmi3DoStep(INSTANCE c, double t, double h, FLAG none, FLAG *event, FLAG *terminate, FLAG *early,
                  double *reached) {
  return (void)none, *event = *terminate = *early = 0, *reached = t + h, step(c, t, h);
}
#endif
