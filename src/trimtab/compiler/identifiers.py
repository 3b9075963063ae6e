"""Names that are valid in C and C++: ASCII, and neither a reserved word, a macro, nor a name of the C library."""

import re
import unicodedata
from collections.abc import Collection

C_WORDS = """
auto break case char const continue default do double else enum extern float for goto if inline int long register
restrict return short signed sizeof static struct switch typedef typeof typeof_unqual union unsigned void volatile while
asm fortran near far huge interrupt
"""
"""Reserved words of C up to C23, and further reserved words of compilers."""
CPP_WORDS = """
alignas alignof and and_eq atomic_cancel atomic_commit atomic_noexcept bitand bitor bool catch char8_t char16_t char32_t
class co_await co_return co_yield compl concept const_cast consteval constexpr constinit contract_assert decltype delete
dynamic_cast explicit export false friend import module mutable namespace new noexcept not not_eq nullptr operator or
or_eq private protected public reflexpr reinterpret_cast requires static_assert static_cast std synchronized template
this thread_local throw true try typeid typename using virtual wchar_t xor xor_eq
"""
"""Reserved words of C++ up to C++26, and the namespace of its library."""
PYTHON_WORDS = "as async await def del elif except finally from global in is lambda nonlocal pass raise with yield"
"""Reserved words of Python. A Python program that calls the C code cannot use them as attributes."""
MACROS = """
assert complex environ errno hpux i386 imaginary linux m68k math_errhandling mips noreturn offsetof optarg pixel
ppc signgam sparc stdalign stderr stdin stdout sun unix unreachable vax vector I PI B0 IN OK
"""
"""Macros of C libraries, systems and compilers. Names of three or more capitals count as macros, too."""
INTEGER_TYPES = r"u?int(_fast|_least)?\d+_t|u?int(max|ptr)_t|s?size_t|ptrdiff_t|(double|float|max_align|va_list|wint)_t"

REAL_FUNCTIONS = """
acos acosh asin asinh atan atan2 atanh cabs cacos cacosh canonicalize carg casin casinh catan catanh cbrt ccos ccosh
ceil cexp cimag clog clog10 conj copysign cos cosh cpow cproj creal csin csinh csqrt ctan ctanh erf erfc exp exp10
exp2 expm1 fabs fdim finite floor fma fmax fmaximum fmaximum_mag fmaximum_mag_num fmaximum_num fmaxmag fmin fminimum
fminimum_mag fminimum_mag_num fminimum_num fminmag fmod frexp fromfp fromfpx gamma getpayload hypot ilogb isinf isnan
j0 j1 jn ldexp lgamma llogb llrint llround log log10 log1p log2 logb lrint lround modf nan nearbyint nextafter
nextdown nexttoward nextup pow remainder remquo rint round roundeven scalb scalbln scalbn setpayload setpayloadsig
significand sin sincos sinh sqrt tan tanh tgamma totalorder totalordermag trunc ufromfp ufromfpx y0 y1 yn
"""
"""Functions of the C library for double. The names for float and long double have the suffix f or l."""
FUNCTIONS = """
a64l abort abs accept accept4 access acct adjtime alarm aligned_alloc alloca arc4random arc4random_buf
arc4random_uniform asctime asprintf assert at_quick_exit atexit atof atoi atol atoll basename bcmp bcopy bind brk
bsearch btowc bzero c16rtomb c32rtomb c8rtomb calloc canonicalize_file_name chdir chmod chown chroot clearenv clearerr
clock clone close close_range closefrom confstr connect copy_file_range creat ctermid ctime cuserid daemon daylight
dcgettext dgettext difftime div dprintf drand48 drem dremf dup dup2 dup3 duplocale dysize eaccess ecvt endusershell
environ erand48 errno euidaccess execl execle execlp execv execve execveat execvp execvpe exit explicit_bzero
faccessat fadd faddl fallocate fchdir fchmod fchmodat fchown fchownat fclose fcloseall fcntl fcvt fdatasync fdiv fdivl
fdopen feclearexcept fedisableexcept feenableexcept fegetenv fegetexcept fegetexceptflag fegetmode fegetround
feholdexcept feof feraiseexcept ferror fesetenv fesetexcept fesetexceptflag fesetmode fesetround fetestexcept
fetestexceptflag feupdateenv fexecve fflush ffma ffmal ffs ffsl ffsll fgetc fgetpos fgets fgetwc fgetws fileno
flockfile fmemopen fmul fmull fopen fopencookie fork fpathconf fpclassify fprintf fputc fputs fputwc fputws fread free
freelocale freopen fscanf fseek fseeko fsetpos fsqrt fsqrtl fstat fstatat fsub fsubl fsync ftell ftello ftruncate
ftrylockfile funlockfile futimens futimes futimesat fwide fwprintf fwrite fwscanf gcvt get_current_dir_name getc
getchar getcpu getcwd getdate getdelim getdomainname getdtablesize getegid getentropy getenv geteuid getgid getgroups
gethostid gethostname getitimer getline getloadavg getlogin getopt getpagesize getpass getpeername getpgid getpgrp
getpid getppid getpt getresgid getresuid getsid getsockname getsockopt getsubopt gettext gettid gettimeofday getuid
getusershell getw getwc getwchar getwd gmtime grantpt group_member gsignal imaxabs imaxdiv index initstate isalnum
isalpha isascii isatty isblank iscntrl isctype isdigit isfdtype isfinite isgraph isgreater isgreaterequal isless
islessequal islessgreater islower isnormal isprint ispunct isspace isunordered isupper iswalnum iswalpha iswblank
iswcntrl iswctype iswdigit iswgraph iswlower iswprint iswpunct iswspace iswupper iswxdigit isxdigit jrand48 kill
killpg l64a labs lchmod lchown lcong48 ldiv link linkat listen llabs lldiv localeconv localtime lockf longjmp lrand48
lseek lstat lutimes main malloc mblen mbrlen mbrtoc16 mbrtoc32 mbrtoc8 mbrtowc mbsinit mbsnrtowcs mbsrtowcs mbstowcs
mbtowc memccpy memchr memcmp memcpy memfrob memmem memmove mempcpy memrchr memset mkdir mkdirat mkdtemp mkfifo
mkfifoat mknod mknodat mkostemp mkostemps mkstemp mkstemps mktemp mktime mrand48 name_to_handle_at nanosleep newlocale
nice nrand48 obstack_printf obstack_vprintf offsetof on_exit open open_by_handle_at open_memstream open_wmemstream
openat optarg opterr optind optopt pathconf pause pclose perror pipe pipe2 popen pow10 pread printf profil pselect
psiginfo psignal ptsname putc putchar putenv puts putw putwc putwchar pwrite qecvt qfcvt qgcvt qsort quick_exit raise
rand random rawmemchr read readahead readlink readlinkat realloc reallocarray realpath recv recvfrom recvmmsg recvmsg
remove rename renameat renameat2 revoke rewind rindex rmdir rpmatch sbrk scanf secure_getenv seed48 select send
sendmmsg sendmsg sendto setbuf setbuffer setdomainname setegid setenv seteuid setgid sethostid sethostname setitimer
setjmp setlinebuf setlocale setlogin setns setpgid setpgrp setregid setresgid setresuid setreuid setsid setsockopt
setstate settimeofday setuid setusershell setvbuf shutdown sigaction sigaddset sigaltstack sigandset sigblock
sigdelset sigemptyset sigfillset siggetmask sighold sigignore siginterrupt sigisemptyset sigismember siglongjmp signal
signbit signgam sigorset sigpause sigpending sigprocmask sigqueue sigrelse sigreturn sigset sigsetjmp sigsetmask
sigstack sigsuspend sigtimedwait sigwait sigwaitinfo sleep snprintf sockatmark socket socketpair splice sprintf srand
srand48 srandom sscanf ssignal stat statx stderr stdin stdout stpcpy stpncpy strcasecmp strcasestr strcat strchr
strchrnul strcmp strcoll strcpy strcspn strdup strerror strfromd strfromf strfroml strfry strftime strlen strncasecmp
strncat strncmp strncpy strndup strnlen strpbrk strptime strrchr strsep strsignal strspn strstr strtod strtof
strtoimax strtok strtol strtold strtoll strtoq strtoul strtoull strtoumax strtouq strverscmp strxfrm swab swprintf
swscanf symlink symlinkat sync sync_file_range syncfs syscall sysconf system sysv_signal tcgetpgrp tcsetpgrp tee
tempnam tgkill time timegm timelocal timespec_get timespec_getres timezone tmpfile tmpnam toascii tolower toupper
towctrans towlower towupper truncate ttyname ttyslot tzname tzset ualarm umask ungetc ungetwc unlink unlinkat unlockpt
unsetenv unshare uselocale usleep utimensat utimes va_arg va_copy va_end va_start valloc vasprintf vdprintf vfork
vfprintf vfscanf vfwprintf vfwscanf vhangup vmsplice vprintf vscanf vsnprintf vsprintf vsscanf vswprintf vswscanf
vwprintf vwscanf wcpcpy wcpncpy wcrtomb wcscasecmp wcscat wcschr wcschrnul wcscmp wcscoll wcscpy wcscspn wcsdup
wcsftime wcslen wcsncasecmp wcsncat wcsncmp wcsncpy wcsnlen wcsnrtombs wcspbrk wcsrchr wcsrtombs wcsspn wcsstr wcstod
wcstof wcstoimax wcstok wcstol wcstold wcstoll wcstombs wcstoq wcstoul wcstoull wcstoumax wcstouq wcswcs wcswidth
wcsxfrm wctob wctomb wctrans wctype wcwidth wmemchr wmemcmp wmemcpy wmemmove wmempcpy wmemset wprintf write wscanf
"""
"""Other functions and variables of the C library and of POSIX, and built-in functions of compilers."""
OWN_FILES = "arguments at count default file inputs line main memory out outputs replay state params vectors workspace"
"""Names that the files of an exported function use themselves."""
OWN_NAMES = r"(tt|ttv|tv|TT|TTV)_\w*|v[fiu]\d+|(a|i|m|v|x|table|default)\d+|\w+_t|\w+_(r|l|np|unlocked)"
OWN_NAMES += r"|(clock|posix|pthread|sched|sem|timer)_\w*|vectors_(set_in|get_out)"
"""Pattern of further names that functions cannot have: those of generated text, of types, and of POSIX functions."""

RESERVED = frozenset(" ".join((C_WORDS, CPP_WORDS, PYTHON_WORDS, MACROS)).split())
RESERVED_FUNCTIONS = frozenset(
    [f"{name}{kind}" for name in REAL_FUNCTIONS.split() for kind in ("", "f", "l")] + f"{FUNCTIONS} {OWN_FILES}".split()
)


def identifier(name: str) -> str:
    """Return a valid C struct member name: ASCII, with an underscore before a digit or after a reserved word or macro.

    >>> [identifier(name) for name in ("rate", "new", "a b", "2nd", "NAN", "\u03b8_0")]
    ['rate', 'new_', 'a_b', '_2nd', 'NAN_', 'theta_0']
    """
    made = re.sub(r"\W", "_", "".join(map(_ascii, name)), flags=re.ASCII) or "_"
    if made[0].isdigit():
        return f"_{made}"
    taken = made in RESERVED or re.fullmatch(rf"[A-Z][A-Z0-9_]{{2,}}|__\w*|_[A-Z]\w*|{INTEGER_TYPES}", made)
    return f"{made}_" if taken else made


def function_identifier(name: str) -> str:
    """Return a valid C function name, with an underscore after a name of the C library or the generated text.

    >>> [function_identifier(name) for name in ("cost", "read", "sin", "export", "tt_sin")]
    ['cost', 'read_', 'sin_', 'export_', 'tt_sin_']
    """
    made = identifier(name)
    return f"{made}_" if made in RESERVED_FUNCTIONS or re.fullmatch(OWN_NAMES, made) else made


def distinct(name: str, taken: Collection[str]) -> str:
    """Return the name, with a number added if the name is taken."""
    made, number = name, 2
    while made in taken:
        made, number = f"{name}_{number}", number + 1
    return made


def _ascii(character: str) -> str:
    """Return a letter in ASCII: a letter without its accent, a Greek letter by its name, else an underscore."""
    if character.isascii():
        return character
    plain = "".join(c for c in unicodedata.normalize("NFKD", character) if not unicodedata.combining(c))
    found = re.fullmatch(r"GREEK (SMALL|CAPITAL) LETTER (?:FINAL )?(\w+).*", unicodedata.name(plain[:1] or "_", ""))
    if found:
        return found[2].lower() if found[1] == "SMALL" else found[2].title()
    return plain if plain.isascii() else "_"
